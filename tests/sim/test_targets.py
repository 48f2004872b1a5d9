"""The table of law targets and the layouts of arrays; and that a target or an effect is added in one file."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import gyrowheel_sim
from gyrowheel_control.loops.kernel import CommandColumn, ControllerState, SetpointColumn
from gyrowheel_core import wire
from gyrowheel_sim.effects.targets import TARGETS, Entry, LawTarget, added, changed, entering
from gyrowheel_sim.instruments import DRIFT_SIZES, Column, Drift, Reading, names
from gyrowheel_sim.plant.compiled import State, Surroundings

from .helpers import BENCH


@pytest.mark.parametrize(
    ("layout", "message"),
    [(Reading, wire.MEASUREMENT), (SetpointColumn, wire.SETPOINT), (CommandColumn, wire.COMMAND)],
    ids=lambda item: getattr(item, "__name__", None),
)
def test_columns_are_the_fields_of_the_message(layout: type[Column], message: wire.Layout) -> None:
    assert names(layout) == message.fields


@pytest.mark.parametrize(
    "layout", [State, Surroundings, Drift, Reading, ControllerState], ids=lambda c: c.__name__
)
def test_every_index_has_unit_and_description(layout: type[Column]) -> None:
    assert names(layout) == tuple(layout.__members__)
    for place in layout:
        assert place.unit
        assert place.description
        if isinstance(place.initial, str):
            assert place.initial in BENCH.values()


def test_drifts_have_sizes_in_the_bench() -> None:
    assert set(DRIFT_SIZES) == set(Drift)
    assert set(DRIFT_SIZES.values()) <= set(BENCH.values())


def test_indices_with_a_gap_are_refused() -> None:
    class Gap(Column):
        first = 0, "1", "first"
        third = 2, "1", "third"

    with pytest.raises(ValueError, match=r"not 0 \.\. 1"):
        names(Gap)


@pytest.mark.parametrize(
    ("entry", "two_axes", "once"),
    [
        (Entry("across"), False, False),  # takes x + i y
        (Entry("shaft"), True, False),  # is real
        (Entry("relative"), False, False),  # of what
        (Entry("shaft", "motor_constant"), False, False),
        (Entry("offset", "air_temperature"), False, False),  # no law can change it
        (Entry("reading", "spin_rate"), False, True),  # the balance takes the speed as it is read
        (Entry("reading", "motor_current"), False, False),  # readings are taken once a sample
        (Entry("along"), False, True),  # torques act all the time
    ],
)
def test_targets_that_contradict_themselves_are_refused(entry: Entry, two_axes: bool, once: bool) -> None:
    with pytest.raises(ValueError, match="target wrong"):
        LawTarget("wrong", "1", "w", "w", (1.0, 2.0), (entry,), complex=two_axes, once_a_sample=once)


def test_laws_are_added_where_their_targets_enter() -> None:
    laws = {"coil_gain": 0.1, "supply_drop": np.array([2.0, 4.0]), "motor_gain": -0.5}
    values = {"supply_voltage": 20.0, "coil_constant": 2.0, "motor_constant": 3.0}
    gain = added(laws, values, "relative", "coil_constant", start=1.0)
    np.testing.assert_allclose(gain, [1.1 - 0.1, 1.1 - 0.2])
    np.testing.assert_allclose(changed(laws, values, "supply_voltage"), [18.0, 16.0])
    assert changed(laws, values, "motor_constant") == 1.5
    assert added({}, values, "shaft") == 0.0
    assert {target.name for target, _ in entering("relative", "coil_constant")} == {
        "coil_gain",
        "supply_drop",
    }
    assert all(target.enters for target in TARGETS.values())


NEW_TARGETS = """
    LawTarget(
        "bearing_change", "1", "relative change of the bearing friction", "relative change of the Coulomb friction",
        (0.05, 0.5), (Entry("relative", "bearing_coulomb"),),
    ),
    LawTarget(
        "current_offset", "A", "error of the current reading", "added to the reading of the motor current",
        (1e-3, 1e-2), (Entry("reading", "motor_current"),), once_a_sample=True,
    ),
"""
NEW_EFFECT = '''
"""An effect on two new targets."""

from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law
from gyrowheel_sim.effects.library.common import symbols
from gyrowheel_sim.effects.quantities import t

b, o = symbols("b", "o")
WEAR = Effect(
    name="wear",
    title="wear",
    category="bearing",
    sentence="The bearing wears, and the ammeter with it.",
    laws=(Law("bearing_change", b), Law("current_offset", o)),
    coefficients=(
        Coefficient("b", "1", "change", (0.05, 0.5), (-1.0, 5.0), "assumed", signed=True),
        Coefficient("o", "A", "offset", (0.001, 0.01), (-1.0, 1.0), "assumed", signed=True),
    ),
    validity="tests",
    source="assumed",
)
'''
#: Simulates a hold with and without the new effect, and fits it; prints what coils and motor show of it.
SCRIPT = """
import json
import numpy as np
from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce
from gyrowheel_control.loops.closed_loop import simulate
from gyrowheel_control.plans import Plan
from gyrowheel_core.readings import Readings
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import get, registry
from gyrowheel_sim.effects.user_defined_line import typed_effect
from gyrowheel_sim.instruments import Reading
from gyrowheel_sim.plant.scenario import Scenario
from tools.docs import effect_page, index_page, tables

bench, plan = Bench.load(), Plan.load("quick")
quiet = {name: 0.0 for name in bench.values() if name.endswith(("_noise", "_drift"))}
values = {"b": 0.4, "o": 0.006}
currents, rows = [], []
wear = get("wear")
for effects in ({}, {"wear": values}):
    run = simulate(bench, Scenario(values=quiet, effects=effects), plan)
    currents.append(run.measurement[20000:, Reading.motor_current].mean())
    time, stamps = np.arange(len(run.measurement)) * bench.sample_period, run.setpoints["stamp_ns"] * 1e-9
    windows = reduce(Samples(time, Readings(run.measurement), stamps, run.setpoints), bench)
    active = [ActiveEffect(wear, values)] if effects else []
    balance = Balance(windows, bench, clean=False, harmonics=False)
    known, without = balance.predicted(bench.values(), active), balance.predicted(bench.values(), [])
    row = balance.row("spin")
    rows.append([float(np.abs((balance.measured - p)[row]).mean()) for p in (known, without)])
print(json.dumps({
    "known": "wear" in registry(),
    "typed": typed_effect("own: bearing_change = w*t; w [1/s]").formula,
    "page": "`bearing_change`" in effect_page(wear, None, bench) and "wear" in index_page([wear]),
    "table": "current_offset" in tables()["targets"],
    "current": currents[1] - currents[0],
    "expected": values["o"] + values["b"] * bench.value("bearing_coulomb") / bench.value("motor_constant"),
    "rows": rows,
}))
"""


@pytest.mark.study  # tests/test_recipes.py does the same by the page
@pytest.mark.slow
def test_a_target_and_an_effect_take_one_file_each(tmp_path: Path) -> None:
    """In a copy of the package: entries in the table, and a module in the library. All else follows."""
    here = Path(gyrowheel_sim.__file__).parent
    package = tmp_path / "gyrowheel_sim"
    shutil.copytree(here, package, ignore=shutil.ignore_patterns("__pycache__"))
    table = package / "effects" / "targets.py"
    before, begin, after = table.read_text(encoding="utf-8").partition("_ALL = (\n")
    table.write_text(before + begin + NEW_TARGETS + after, encoding="utf-8")
    (package / "effects" / "library" / "wear.py").write_text(NEW_EFFECT, encoding="utf-8")
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(root)))},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["known"]
    assert found["typed"] == "bearing_change = w*t"
    assert found["page"]
    assert found["table"]
    # the motor works against the friction, and its current is read with the offset
    assert found["current"] == pytest.approx(found["expected"], rel=0.02)
    # the balance with the effect fits the simulated machine as well as that without it fits the machine without it
    (clean, _), (known, unknown) = found["rows"]
    assert known < 2.0 * clean + 1e-7
    assert unknown > 100.0 * known
