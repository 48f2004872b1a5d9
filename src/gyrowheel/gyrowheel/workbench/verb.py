"""The verb `workbench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from gyrowheel.cli.console import notes, out
from gyrowheel.cli.options import argument, option


def workbench(
    directories: Annotated[
        list[Path] | None, argument("[DIR]...", "Folders with recordings.", "the working directory")
    ] = None,
    model: Annotated[
        Path | None, option("--model M.yaml", "Model file.", "the bench without effects")
    ] = None,
    port: Annotated[int, option("--port N", "Port; 0: any that is free.", min=0, max=65535)] = 8080,
    address: Annotated[
        str, option("--address A", "Address to listen on; any but loopback asks for a token.")
    ] = "127.0.0.1",
    token: Annotated[
        bool, option("--token", "Ask for a token on this computer, too, where others have accounts.")
    ] = False,
    live: Annotated[
        bool, option("--live/--no-live", "Show a bench that runs on this computer, where ROS is.")
    ] = True,
) -> None:
    """Compare, diagnose, add and undo in a browser, until Ctrl-C.

    Opens a page on this computer alone: recordings of the folders, their
    signals, where the model fails, what is missing, and how the error falls.
    """
    import contextlib
    import threading

    import gyrowheel as gw
    from gyrowheel.workbench.library import Library
    from gyrowheel.workbench.server import Server
    from gyrowheel.workbench.session import Session

    loaded = gw.Model() if model is None else gw.Model.load(model)
    library = Library(directories or [Path()])
    session = Session(library, loaded, model)
    with (
        Server(session, address, port, token=token) as server,
        session.live if live else contextlib.nullcontext(),
    ):
        out().print(f"page: {server.url}", soft_wrap=True)
        if server.access.token:
            notes().print(f"token: {server.access.token}", soft_wrap=True)
        notes().print("Ctrl-C ends it")
        try:
            threading.Event().wait()
        finally:
            if session.step.model is not session.kept:
                notes().print("the changes of the model were not saved")
