"""The verb that shows the bench in a viewer."""

from __future__ import annotations

import contextlib
from typing import Annotated

import typer

from gyrowheel.cli.console import notes, out, working
from gyrowheel.cli.options import Namespace, example


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
    namespace: Namespace = "",
) -> None:
    """Show the running bench, or a replay, in the viewer Foxglove until Ctrl-C.

    Start it beside `gyrowheel up` or `gyrowheel replay`, open the address that
    it prints in Foxglove (Open connection), and import the layout that it
    names.
    """
    import tempfile
    import time
    from pathlib import Path

    from gyrowheel.graph.api import foxglove, foxglove_layout, share_file

    with contextlib.ExitStack() as stack:
        with working("starting the server"):
            address = stack.enter_context(foxglove(port, origin or (), namespace=namespace))
        layout = share_file("config/foxglove_layout.json")
        if namespace.strip("/"):  # its topics have other names
            layout = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="gyrowheel-"))) / layout.name
            layout.write_text(foxglove_layout(namespace), encoding="utf-8")
        out().print(f"address: {address}", soft_wrap=True)
        out().print(f"layout: {layout}", soft_wrap=True)
        notes().print("Ctrl-C ends it")
        while True:
            time.sleep(3600.0)
