"""All tables of the command line at the widths of terminals: no cell of a table goes on in the next line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table

import gyrowheel
from gyrowheel.air_flow.page import mesh_page, result_page, sweep_page, table_page
from gyrowheel.batches.page import batch_page
from gyrowheel.blind_tests.page import truth_table
from gyrowheel.campaigns.judge import Judged
from gyrowheel.campaigns.page import campaign_page
from gyrowheel.campaigns.summary import Summary
from gyrowheel.cli.app import app
from gyrowheel.diagnosis.page import diagnosis_page
from gyrowheel.drag_comparison.page import drag_page
from gyrowheel.graph.page import replay_page
from gyrowheel.investigation.api import Investigation
from gyrowheel.investigation.procedure import Course, Step
from gyrowheel.show.layout import UncutTable, plain_text
from gyrowheel.trends.page import trend_page
from gyrowheel_air.table import TorqueTable
from gyrowheel_analysis.trend import trend

from .conftest import Wheel
from .findings import AMBIGUOUS, UNKNOWN, diagnosis, finding
from .helpers import SHORT_PLAN, Shell, write
from .test_render import ESTIMATE

#: Widths of terminals; longer lines than 110 are not written.
WIDTHS = (80, 110, 120)
#: What stands left of a cell in a line of its own, or beside it where it is prose.
BESIDE = 14

Page = Callable[[], Iterable[RenderableType]]

#: A batch in which one quantity makes a step and another one does not.
TREND = [
    {"recording": f"{k}", "machine": f"wheel {k}", "start": 1.7e9 + 86400.0 * k}
    | {"v": 1.0, "v.error": 0.1, "w": 1.0 + 0.1 * (k % 3) + 4.0 * (k > 6), "w.error": 0.1}
    for k in range(12)
]


def verbs(of: typer.Typer, before: str = "") -> Iterator[str]:
    """Yield all verbs of the command line."""
    for command in of.registered_commands:
        assert command.callback is not None
        yield before + (command.name or command.callback.__name__)
    for group in of.registered_groups:
        assert group.typer_instance is not None
        yield from verbs(group.typer_instance, f"{group.name or group.typer_instance.info.name} ")


def judged(index: int, kind: str, outcome: Any, named: list[str]) -> Judged:
    truth = {"windage": {"w": 1e-3}, "flexure_hysteresis": {"h": 1e-3}} if kind == "pair" else {}
    truth = truth or ({} if kind == "none" else {"stiffness_anisotropy": {"k": 1e-2}})
    verdict = "effect" if named else "nothing_missing"
    return Judged(
        index, kind, truth, dict.fromkeys(truth, 31.0), True, verdict, named, [], outcome, seconds=2.0
    )


CAMPAIGN = Summary.counted(
    1,
    400,
    [
        judged(1, "none", "misnamed", ["aero_restoring", "flexure_hysteresis", "commutation_ripple"]),
        judged(2, "single", "exact", ["stiffness_anisotropy"]),
        judged(3, "pair", "partial", ["windage", "stiffness_anisotropy", "commutation_ripple"]),
        judged(4, "outside", "unknown", []),
    ],
)  # fmt: skip
FIRST = Step(1, ("survey",), "nothing is known yet", (), 3.0, AMBIGUOUS, ("aero_cross or flexure_damping.",))
SECOND = Step(
    2,
    ("air_density", "cone"),
    "separates aero_cross from flexure_damping",
    (),
    1.8,
    UNKNOWN,
    ("Something is missing that no known effect explains.", "flexure_damping is ruled out."),
)
INVESTIGATION = Investigation.of(Course("wheel.yaml", 15.0, (FIRST, SECOND)), folder=Path("runs"))
MESH = {"cells": 1234567, "non_orthogonality": 65.4, "skewness": 3.21, "aspect_ratio": 1234.0, "ok": True}
TWO = diagnosis("effect", finding("stiffness_anisotropy"), finding("commutation_ripple", size=-1.0))


def torque_table() -> TorqueTable:
    return TorqueTable.load()


#: What every verb shows: pages of made-up results for those that take minutes or start nodes.
PAGES: dict[str, Page] = {
    "demo": lambda: [truth_table({"windage": {"w": 1e-3, "n": 1.5}, "gravity_offset": {"G": 1e-2}}, TWO)],
    "up": lambda: drag_page([ESTIMATE] * 3),
    "replay": lambda: replay_page(
        SimpleNamespace(
            counts={"/gyrowheel/measurement": 1}, wall=1.0, complete=True, rounds=1, left_out={}, estimates=[ESTIMATE]
        ),  # type: ignore[arg-type]
        1.0,
    ),
    "diagnose": lambda: [part for found in (TWO, AMBIGUOUS, UNKNOWN) for part in diagnosis_page(found)],
    "investigate": lambda: INVESTIGATION.page(),
    "campaign": lambda: campaign_page(CAMPAIGN),
    "batch": lambda: batch_page(
        [
            {"recording": "runs/monday", "verdict": "effect", "effects": "windage, aero_cross", "error": ""},
            {"recording": "runs/tuesday", "verdict": "failed", "effects": None, "error": "runs/tuesday: damaged"},
        ]
    ),
    "trend": lambda: trend_page(trend(TREND)),
    "cfd mesh": lambda: mesh_page(torque_table().rows[0].case, MESH, "out/mesh"),
    "cfd run": lambda: result_page(torque_table().rows[3], "out/case"),
    "cfd sweep": lambda: sweep_page(SimpleNamespace(results=[1], reused=0, failed={}), "out"),  # type: ignore[arg-type]
    "cfd table": lambda: table_page(torque_table()),
}  # fmt: skip
#: And what is typed for the others; several commands where one shows not everything. RUN, MODEL and so on are files.
COMMANDS: dict[str, list[str]] = {
    "simulate": ["simulate --plan PLAN -o NEW"],
    "info": ["info RUN"],
    "salvage": ["salvage RUN -o NEW"],
    "correct": ["correct RUN -o NEW --scale tilt_x=-1 --exchange coil_voltage_x:coil_voltage_y"],
    "import": ["export RUN -o TABLE.csv --map TABLE.yaml", "import TABLE.csv --map TABLE.yaml -o NEW"],
    "export": ["export RUN -o TABLE.parquet"],
    "compare": [
        "compare RUN --model MODEL",
        "compare RUN --model MODEL --map speed,azimuth --map tilt --map time,azimuth",
    ],
    "rate": ["rate RUN --model MODEL"],
    "torques": ["torques RUN --model MODEL", "torques --tilt 3 --speed 1000..4000"],
    "momentum": ["momentum"],
    "drag": ["drag RUN --model MODEL"],
    "paper": ["paper --only eq-1-last --only fig-7 --only fig-8-growth"],
    "key": ["key KEY", "key KEY --against MODEL"],
    "calibrate": ["calibrate RUN --model MODEL"],
    "effects": ["effects", *(f"effects {name}" for name in ("windage", "external_damping", "coil_heating"))],
    "plans": ["plans", *(f"plans {name}" for name in ("survey", "preheat", "rate_table", "paper_speed"))],
    "bench": ["bench", "bench --bench dtg"],
    "air": ["air", "air --tilt 2 --speed 3000"],
    "run": ["run"],
    "model new": ["model new --model NEW"],
    "model add": ["model add windage --model MODEL --fit RUN --validate OTHER"],
    "model fit": [
        "model add windage --model MODEL --fit RUN",
        "model fit --free windage --model MODEL --fit RUN",
    ],
    "model remove": ["model add windage --model MODEL --fit RUN", "model remove windage --model MODEL"],
    "model show": ["model add windage --model MODEL --fit RUN", "model show --model MODEL"],
    "model undo": ["model add windage --model MODEL --fit RUN", "model undo --model MODEL"],
    "model diff": ["model add windage --model MODEL --fit RUN", "model diff OLD MODEL"],
}
#: Verbs that print no table: `live` and `workbench` run on, `report`, `cfd pictures` and `model export` write files.
NO_PAGE = {"live", "workbench", "report", "cfd pictures", "model export"}
NO_TABLE = {"correct", "simulate", "import", "export", "run", "model new", "cfd sweep", "model remove"}


def test_every_verb_has_a_page_or_command_here():
    assert sorted(verbs(app)) == sorted([*PAGES, *COMMANDS, *NO_PAGE])


def test_all_tables_come_from_the_layout():
    root = Path(gyrowheel.__file__).parent
    made = {path.name for path in root.rglob("*.py") if re.search(r"\bTable\(|Table\.grid", path.read_text())}
    assert made == {"layout.py"}


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> list[UncutTable]:
    """Return a list that every table joins as it is shown."""
    tables: list[UncutTable] = []
    original = UncutTable.__rich_console__

    def note(self: UncutTable, *args: Any) -> Any:
        tables.append(self)
        return original(self, *args)

    monkeypatch.setattr(UncutTable, "__rich_console__", note)
    return tables


def assert_whole(table: Table, width: int) -> None:
    """Insist on every cell of a table in one line, and on each title."""
    lines = plain_text([Padding(table, (0, 0, 0, 2))], width).splitlines()
    assert max(map(len, lines)) <= width
    assert not any("…" in line for line in lines)
    for column in table.columns:
        for cell in [*([column.header] if table.show_header else []), *column.cells]:
            for part in str(cell).splitlines():
                if len(part) <= width - BESIDE:
                    assert any(part.strip() in line for line in lines), f"broken: {part!r}"
                else:  # longer than a line: it goes on in lines that hold nothing else
                    assert "".join(part.split()) in "".join("".join(lines).split())


@pytest.mark.parametrize("verb", PAGES)
def test_pages_have_no_broken_cell(verb: str, noted: list[UncutTable]):
    plain_text(PAGES[verb](), 80)
    tables = list(noted)
    assert bool(tables) != (verb in NO_TABLE)
    for table in tables:
        for width in WIDTHS:
            assert_whole(table, width)


@pytest.mark.parametrize("verb", COMMANDS)
def test_commands_have_no_broken_cell(
    verb: str, noted: list[UncutTable], gyrowheel: Shell, wheel: Wheel, tmp_path: Path
):
    model = write(tmp_path / "model.yaml", wheel.model.read_text())
    key = '{"values": {"rotor_inertia_z": 1.766e-3}, "effects": {"windage": {"w": 0.0013, "n": 1.5}}}'
    files = {
        "RUN": wheel.recording,
        "OTHER": wheel.other,
        "MODEL": model,
        "OLD": wheel.model,
        "KEY": write(tmp_path / "key.json", key),
        "PLAN": write(tmp_path / "plan.yaml", SHORT_PLAN),
        "NEW": tmp_path / "new.d",
        "TABLE.csv": tmp_path / "table.csv",
        "TABLE.parquet": tmp_path / "table.parquet",
        "TABLE.yaml": tmp_path / "table.yaml",
    }
    for command in COMMANDS[verb]:
        noted.clear()
        shown = gyrowheel.good(*(files.get(word, word) for word in command.split())).out
        if not command.startswith(verb):
            continue
        assert "…" not in shown
        tables = list(noted)
        assert bool(tables) != (verb in NO_TABLE), command
        for table in tables:
            for width in WIDTHS:
                assert_whole(table, width)


def test_the_check_sees_a_broken_cell():
    """A table of rich itself, which breaks cells, does not pass."""
    from gyrowheel.show.layout import words_table

    table = words_table("name", "what it is")
    table.add_row("x" * 30, "a text of some length that has no room beside the name")
    assert_whole(table, 80)
    wrapped = {"__rich_console__": Table.__rich_console__}
    table.__class__ = type("Wrapping", (UncutTable,), wrapped)
    with pytest.raises(AssertionError, match="broken"):
        assert_whole(table, 80)
