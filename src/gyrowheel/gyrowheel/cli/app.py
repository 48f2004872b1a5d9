"""The command line put together from its verbs."""

from __future__ import annotations

import gc
import io
import signal
import sys
from types import FrameType
from typing import Annotated

import typer

from gyrowheel import __version__
from gyrowheel.air_flow import verb as air_flow
from gyrowheel.blind_tests import verb as blind_tests
from gyrowheel.calibration import verb as calibration
from gyrowheel.campaigns import verb as campaigns
from gyrowheel.catalogue import verb as catalogue
from gyrowheel.cli.console import run
from gyrowheel.cli.outputs import guard
from gyrowheel.comparison import verb as comparison
from gyrowheel.demonstration import verb as demonstration
from gyrowheel.diagnosis import verb as diagnosis
from gyrowheel.drag_comparison import verb as drag_comparison
from gyrowheel.graph import verb as graph
from gyrowheel.investigation import verb as investigation
from gyrowheel.models import verb as models
from gyrowheel.momentum_envelope import verb as momentum_envelope
from gyrowheel.paper_figures import verb as paper_figures
from gyrowheel.rate_sensing import verb as rate_sensing
from gyrowheel.recordings import verb as recordings
from gyrowheel.report import verb as report
from gyrowheel.simulation import verb as simulation
from gyrowheel.tables import verb as tables
from gyrowheel.torque_budget import verb as torque_budget
from gyrowheel.workbench import verb as workbench

app = typer.Typer(
    name="gyrowheel",
    help="Test bench of a gyroscopic wheel: run it, compare recordings with the model, find what the model lacks.",
    epilog=(
        "Exit codes: 0 success, 1 a finding that you asked to fail on, 2 bad input, 3 a node of the bench failed, "
        "70 an internal error, 130 interrupted."
    ),
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and end.")
    ] = False,
) -> None:
    pass


for register in (
    demonstration.register,
    graph.register_up,
    simulation.register,
    recordings.register,
    graph.register_replay,
    tables.register,
    recordings.register_correct,
    comparison.register,
    diagnosis.register,
    rate_sensing.register,
    report.register,
    workbench.register,
    torque_budget.register,
    momentum_envelope.register,
    paper_figures.register,
    drag_comparison.register,
    investigation.register,
    blind_tests.register,
    calibration.register,
    models.register,
    catalogue.register,
    air_flow.register,
    campaigns.register,
    graph.register_run,
):
    register(app)
guard(app)


def main() -> None:
    """Run the command line and end the process with its exit code."""
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _terminate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that has no ± gets a question mark
            stream.reconfigure(errors="replace")
    code = run(app)
    # what is left goes with the process; looking through it for garbage first takes a tenth of a short verb
    gc.freeze()
    sys.exit(code)


def _terminate(number: int, frame: FrameType | None) -> None:
    # unwinds, so that nothing half-written and no child process stays behind
    raise SystemExit(128 + number)
