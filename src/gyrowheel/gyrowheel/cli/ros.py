"""Verbs that stand in for the ROS command line where there is none."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrowheel.cli.options import example


def register(app: typer.Typer) -> None:
    """Add the verbs."""
    settings = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
    app.command(
        epilog=example("gyrowheel run gyrowheel_sim plant_node --ros-args -p publish_truth:=true"),
        context_settings=settings,
    )(run)


def run(
    context: typer.Context,
    package: Annotated[str, typer.Argument(metavar="PKG", help="Package.", show_default=False)],
    executable: Annotated[str, typer.Argument(metavar="EXE", help="Executable of it.", show_default=False)],
) -> None:
    """Start one node, as ros2 run does; further arguments go to the node."""
    from gyrowheel.graph import run_executable

    run_executable(package, executable, context.args)
