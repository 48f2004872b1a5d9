"""The verb that shows the bench in a viewer."""

from __future__ import annotations

import contextlib
from typing import Annotated

import typer

from gyrowheel.cli.options import example
from gyrowheel.cli.shell import notes, out, working


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command(epilog=example("gyrowheel live --port 8765"))(live)


def live(
    port: Annotated[
        int, typer.Option("--port", metavar="N", min=0, max=65535, help="Port on this computer; 0: any.")
    ] = 8765,
    origin: Annotated[
        list[str] | None,
        typer.Option(
            "--origin",
            metavar="URL",
            help="A web page that may read too, such as https://app.foxglove.dev; repeatable. Pages of other sites are "
            "refused.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Show the running bench, or a replay, in the viewer Foxglove until Ctrl-C.

    Start it beside `gyrowheel up` or `gyrowheel replay`, open the address that
    it prints in Foxglove (Open connection), and import the layout that it
    names.
    """
    import time

    from gyrowheel.graph import foxglove, share_file

    with contextlib.ExitStack() as stack:
        with working("starting the server"):
            address = stack.enter_context(foxglove(port, origin or ()))
        out().print(f"address: {address}", soft_wrap=True)
        out().print(f"layout: {share_file('config/foxglove_layout.json')}", soft_wrap=True)
        notes().print("Ctrl-C ends it")
        while True:
            time.sleep(3600.0)
