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
    package: Annotated[
        str | None,
        typer.Argument(metavar="PKG", help="Package.", show_default="lists all packages"),
    ] = None,
    executable: Annotated[
        str | None,
        typer.Argument(metavar="EXE", help="Executable of it.", show_default="lists those of the package"),
    ] = None,
) -> None:
    """Start one node, as ros2 run does; further arguments go to the node.

    Without arguments it lists packages and executables.
    """
    # after a package and an executable, --help is for the node
    if {package, executable} & {"-h", "--help"}:
        typer.echo(context.get_help())
        return
    from gyrowheel.graph.api import executables, find_executable, run_executable

    if package is not None and executable is not None:
        run_executable(package, executable, context.args)
    known = executables()
    if package is not None and package not in known:
        find_executable(package, "")  # says what is wrong
    for name in known if package is None else [package]:
        typer.echo(name)
        for own in known[name]:
            typer.echo(f"  {own}")
