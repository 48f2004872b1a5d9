"""The command line put together from its verbs."""

from __future__ import annotations

import gc
import io
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Annotated

import typer

from gyrowheel import __version__
from gyrowheel.air_flow import verb as air_flow
from gyrowheel.batches import verb as batches
from gyrowheel.blind_tests import verb as blind_tests
from gyrowheel.calibration import verb as calibration
from gyrowheel.campaigns import verb as campaigns
from gyrowheel.catalogue import verb as catalogue
from gyrowheel.cli.console import bad_input, run
from gyrowheel.cli.options import example
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
from gyrowheel.trends import verb as trends
from gyrowheel.workbench import verb as workbench
from gyrowheel_core.errors import InputError
from gyrowheel_core.surroundings import begin

app = typer.Typer(
    name="gyrowheel",
    help="Test bench of a gyroscopic wheel: run it, compare recordings with the model, find what the model lacks.",
    epilog=(
        "Begin with: gyrowheel demo. "
        "Exit codes: 0 success, 1 a finding or a failed check, 2 bad input, 3 a node of the bench failed, "
        "70 an internal error, 130 interrupted."
    ),
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    add_completion=True,
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


#: Verbs by subject, in the order of the help, each with an example.
_VERBS: dict[str, tuple[tuple[Callable[..., None] | typer.Typer, str], ...]] = {
    "The loop: compare, see where, learn what, add, watch": (
        (demonstration.demo, "demo --seed 3"),
        (comparison.compare, "compare runs/monday --model wheel.yaml --map speed,azimuth"),
        (diagnosis.diagnose, "diagnose runs/monday --model wheel.yaml"),
        (models.model_app, "model show --model wheel.yaml"),
        (batches.batch, "batch runs --model wheel.yaml -o results.parquet"),
        (trends.trend, "trend results.parquet --picture trend.png"),
        (investigation.investigate, "investigate --model wheel.yaml --blind key.json --budget 10"),
        (workbench.workbench, "workbench runs --model wheel.yaml"),
        (report.report, "report runs/monday --model wheel.yaml -o monday.html"),
    ),
    "Make a recording": (
        (simulation.simulate, "simulate --plan quick -o runs/monday --effect windage:w=0.001"),
        (graph.up, "up --plan quick --record runs/monday --effect windage"),
        (graph.replay, "replay runs/monday --from 10 --to 20 --rate 0.5"),
        (graph.live, "live --port 8765"),
    ),
    "Recordings and tables": (
        (recordings.info, "info runs/monday"),
        (tables.import_, "import test.csv --map test.map.yaml -o runs/test"),
        (tables.export, "export runs/monday -o monday.parquet"),
        (recordings.correct, "correct runs/monday -o runs/right --exchange tilt_x:tilt_y"),
        (recordings.salvage, "salvage runs/monday -o runs/monday_saved"),
    ),
    "Benches, plans, effects": (
        (catalogue.effects, "effects windage"),
        (catalogue.plans, "plans quick"),
        (catalogue.bench, "bench"),
        (calibration.calibrate, "calibrate runs/cone runs/coast_down --model wheel.yaml"),
    ),
    "Torques, rates, air": (
        (drag_comparison.drag, "drag runs/tilts --model wheel.yaml"),
        (torque_budget.torques, "torques --tilt 3 --speed 1000..4000"),
        (momentum_envelope.momentum, "momentum --bench dtg --picture caps.png"),
        (rate_sensing.rate, "rate runs/rate_table --model wheel.yaml"),
        (air_flow.air, "air --tilt 5 --speed 3500"),
        (air_flow.cfd_app, "cfd run --tilt 5 --speed 3500 --mesh coarse -o runs/air"),
        (paper_figures.paper, "paper -o paper"),
    ),
    "Is the answer right?": (
        (blind_tests.key, "key key.json --against wheel.yaml"),
        (campaigns.campaign, "campaign --cases 40 --seed 3 --plan quick"),
    ),
}
for panel, verbs in _VERBS.items():
    for verb, shown in verbs:
        name, epilog = shown.partition(" ")[0], example(f"gyrowheel {shown}")
        if isinstance(verb, typer.Typer):
            app.add_typer(verb, name=name, epilog=epilog, rich_help_panel=panel)
        else:
            app.command(name, epilog=epilog, rich_help_panel=panel)(verb)
app.command(
    epilog=example("gyrowheel run gyrowheel_sim plant_node --ros-args -p publish_truth:=true"),
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []},
    rich_help_panel="Make a recording",
)(graph.run)
guard(app)


_OBJECTS = 50_000  # new ones between two searches for garbage


def main() -> None:
    """Run the command line and end the process with its exit code."""
    # modules and declarations are hundreds of thousands of objects that stay: to search them for garbage at every
    # 700 new objects takes a tenth of the time of a diagnosis
    gc.set_threshold(_OBJECTS)
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _terminate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that has no ± gets a question mark
            stream.reconfigure(errors="replace")
    try:
        begin()
    except InputError as error:
        sys.exit(bad_input(str(error)))
    code = run(app)
    # no garbage collection at exit: it takes a tenth of the time of a short verb
    gc.freeze()
    sys.exit(code)


def _terminate(number: int, frame: FrameType | None) -> None:
    # unwinds, so that nothing half-written and no child process stays behind
    raise SystemExit(128 + number)
