"""Wrong setups: named with the cure that works; right recordings are left alone."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gyrowheel as gw
from benchmarks.setups import COIL, TILT, TURN, WRONG, Samples, Spoil, exchanged, scaled, spoilt
from gyrowheel.show.sentences.setup import problem
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled import Fix, correct, corrected
from gyrowheel_recording.mislabelled.blocks import NAMES, blocks_of
from gyrowheel_recording.mislabelled.find import wrong_setups
from gyrowheel_sim.bench import Bench

#: Slow enough that the coils can turn twice the momentum.
SLOW = """\
schema: 1
name: slow
hold_s: 1.3
segments:
  - {spin_rpm: 2000, tilt_deg: [[0, 0], [2, 0], [0, 2], [-2, 0]]}
  - {spin_rpm: 1500, tilt_deg: [[0, 0], [0, -2], [2, 0]]}
"""


@pytest.fixture(scope="module")
def right() -> Recording:
    # an effect of twice its usual size, on a machine of its own
    return gw.simulate("quick", effects={"gravity_offset": {"G": 0.012}}, machine=11, seed=3).data


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench.load()


#: Of each kind one or two; the others are a study.
EVERY_TIME = (
    "both exchanged", "sign of tilt_x", "sign of motor_current", "tilts in degrees", "mV of the coils read as µV",
    "temperatures in °C", "wheel turns the other way", "tilts doubled", "one tilt halved", "gear of 2", "speed late",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "kind", "columns"),
    [
        pytest.param(*wrong, id=name, marks=[] if name in EVERY_TIME else [pytest.mark.study])
        for name, *wrong in WRONG
    ],
)
def test_wrong_setup_is_named_and_its_fix_restores_the_readings(
    right: Recording, bench: Bench, spoil: Spoil, kind: str, columns: tuple[str, ...]
) -> None:
    wrong = spoilt(right, spoil)
    (found,) = wrong_setups([wrong], bench)
    assert (found.kind, found.columns) == (kind, columns)
    mended = corrected(wrong.measurement, found.cure)
    assert not wrong_setups([replace(right, measurement=mended)], bench)
    original = right.measurement[np.isin(right.measurement["sequence"], mended["sequence"])]
    rolled = round(3.0 / 5e-4) if kind == "shifted" else 0  # the fixture's roll puts the end at the beginning
    for name in columns if kind != "reversed" else ("tilt_x", "coil_voltage_x"):
        difference = np.abs(mended[name] - original[name])[: len(mended) - rolled]
        if name == "spin_angle":
            difference = np.minimum(difference, TURN - difference)
            if columns == ("spin_angle",) and kind == "scale":
                continue  # half a turn of the sensor's own zero cannot be known
        assert difference.max() <= 1e-6 * np.abs(original[name]).max()


@pytest.mark.slow
def test_stuck_and_repeated_columns_are_named_without_a_fix(right: Recording, bench: Bench) -> None:
    for spoil, kind, columns in (
        (lambda s: s["tilt_y"].fill(0.01), "stuck", ("tilt_y",)),
        (lambda s: s["spin_angle"].fill(1.0), "stuck", ("spin_angle",)),
        (lambda s: s["motor_voltage"].fill(11.0), "stuck", ("motor_voltage",)),
        (lambda s: s.__setitem__("coil_voltage_y", s["coil_voltage_x"]), "same", COIL),
    ):
        (found,) = wrong_setups([spoilt(right, spoil)], bench)
        assert (found.kind, found.columns, bool(found.cure)) == (kind, columns, False)


@pytest.mark.parametrize("factor", [0.1, 0.8, 3.0])
def test_times_of_another_rate_are_named(right: Recording, bench: Bench, factor: float) -> None:
    """Nothing else can be judged by such times; where speed and angle alone differ, the motor decides."""

    def slowed(samples: Samples) -> None:
        samples["stamp_ns"] = (factor * samples["stamp_ns"]).astype(np.int64)

    (found,) = wrong_setups([spoilt(right, slowed)], bench)
    assert (found.kind, found.columns, bool(found.cure)) == ("clock", ("spin_angle", "spin_rate"), False)
    assert found.value == pytest.approx(factor, rel=1e-3)


def test_times_that_count_half_as_fast_are_named_beside_the_gear(right: Recording, bench: Bench) -> None:
    def slowed(samples: Samples) -> None:
        samples["stamp_ns"] *= 2

    (found,) = wrong_setups([spoilt(right, slowed)], bench)
    assert (
        "counts 0.5 turns a turn of the rotor, or the times of the samples are to be divided by 2"
        in problem(found)
    )


def test_a_clock_within_its_tolerance_is_no_wrong_setup(right: Recording, bench: Bench) -> None:
    def slowed(samples: Samples) -> None:
        samples["stamp_ns"] = (1.01 * samples["stamp_ns"]).astype(np.int64)

    assert not wrong_setups([spoilt(right, slowed)], bench)


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("motor_voltage", "air_temperature"),
        ("motor_current", "coil_voltage_x"),
        ("spin_rate", "coil_voltage_y"),
        ("spin_angle", "motor_voltage"),
        ("coil_voltage_y", "motor_voltage"),
        ("tilt_x", "motor_current"),
    ],
)
def test_another_signal_in_a_column_is_named(right: Recording, bench: Bench, name: str, other: str) -> None:
    def spoil(samples: Samples) -> None:
        samples[name] = samples[other]

    wrong = spoilt(right, spoil)
    (found,) = wrong_setups([wrong], bench)
    assert (found.kind, found.columns) == ("foreign", (name,))
    assert f"{name} is another signal" in problem(found)
    if name == "tilt_x":  # nothing can be done without it
        assert not found.cure
        return
    assert found.cure == Fix(without=(name,))
    mended = replace(right, measurement=corrected(wrong.measurement, found.cure))
    assert not wrong_setups([mended], bench)


def test_without_commands_and_setpoints_both_tilt_and_coil_may_be_another_signal(
    right: Recording, bench: Bench
) -> None:
    def spoil(samples: Samples) -> None:
        samples["tilt_x"] = samples["motor_current"]

    bare = replace(right, setpoint=right.setpoint[:0], command=right.command[:0])
    (found,) = wrong_setups([spoilt(bare, spoil)], bench)
    assert (found.columns, found.otherwise) == (("coil_voltage_y",), (("tilt_x",),))


@pytest.mark.parametrize("name", ["motor_voltage", "motor_current", "spin_rate"])
def test_a_reading_that_fails_for_a_while_is_no_other_signal(
    right: Recording, bench: Bench, name: str
) -> None:
    def spoil(samples: Samples) -> None:
        samples[name][6000:8000] = 0.0

    assert not wrong_setups([spoilt(right, spoil)], bench)


def test_readings_of_another_run_are_not_joined(right: Recording, bench: Bench) -> None:
    other = gw.simulate("check", machine=12, seed=5).data.measurement

    def spoil(samples: Samples) -> None:
        for name in COIL:
            samples[name] = np.resize(other[name], len(samples))

    (found,) = wrong_setups([spoilt(right, spoil)], bench)
    assert (found.kind, found.columns) == ("foreign", (*TILT, *COIL))


def test_two_mistakes_at_once(right: Recording, bench: Bench) -> None:
    def spoil(samples: Samples) -> None:
        exchanged(TILT)(samples)
        scaled("spin_rate", by=30.0 / math.pi)(samples)

    found = wrong_setups([spoilt(right, spoil)], bench)
    assert [(f.kind, f.columns) for f in found] == [("unit", ("spin_rate",)), ("exchanged", TILT)]


def without(names: tuple[str, ...], spoil: Spoil | None = None) -> Spoil:
    """Return what spoils readings, and takes away others that were never measured."""

    def both(samples: Samples) -> None:
        if spoil is not None:
            spoil(samples)
        for name in names:
            samples[name] = np.nan

    return both


#: What was never measured, what is wrong beside it, and what must be named.
BESIDE = [
    (("spin_angle",), scaled("spin_rate", by=30.0 / math.pi), "unit", ("spin_rate",)),
    (("spin_rate",), scaled("spin_angle", by=180.0 / math.pi), "unit", ("spin_angle",)),
    (("spin_angle", "motor_current"), scaled("motor_voltage", by=1e3), "unit", ("motor_voltage",)),
    (("motor_voltage",), scaled("motor_current", by=-1.0), "sign", ("motor_current",)),
    (("motor_voltage", "motor_current"), exchanged(TILT), "exchanged", TILT),
    (("spin_angle",), exchanged(COIL), "exchanged", COIL),
    (("coil_voltage_x",), scaled(*TILT, by=180.0 / math.pi), "unit", TILT),
    (("coil_voltage_y",), scaled("coil_voltage_x", by=1e3), "unit", ("coil_voltage_x",)),
    (("coil_temperature", *COIL), scaled("spin_rate", by=-1.0), "sign", ("spin_rate",)),
]


@pytest.mark.slow
def test_wrong_setup_is_found_with_missing_readings(right: Recording, bench: Bench) -> None:
    for absent, spoil, kind, columns in BESIDE:
        assert not wrong_setups([spoilt(right, without(absent))], bench), absent
        found = wrong_setups([spoilt(right, without(absent, spoil))], bench)
        assert [(own.kind, own.columns) for own in found] == [(kind, columns)], (absent, columns)


@pytest.mark.parametrize(
    ("plan", "effects"),
    [
        ("cone", {"external_damping": {"D": 0.04}}),
        ("check", {"coil_anisotropy": {"p_x": 0.2, "p_y": -0.2}, "coil_tilt": {}}),
        ("rate_table", {}),
        ("paper_speed", {"cubic_stiffness": {"q": 8.0}}),
    ],
)
@pytest.mark.slow
def test_correct_recordings_have_no_wrong_setup(bench: Bench, plan: str, effects: dict[str, Any]) -> None:
    recording = gw.simulate(plan, effects=effects, machine=8, seed=1).data
    bare = replace(recording, setpoint=recording.setpoint[:0], command=recording.command[:0])
    assert not wrong_setups([recording, bare], bench)


def test_constants_off_by_half_are_no_wrong_setup(right: Recording) -> None:
    stated = Bench.load()
    for name in ("coil_constant", "rotor_inertia_z", "motor_constant", "flexure_stiffness_x"):
        for factor in (0.55, 1.45):
            other = stated.with_values({name: factor * stated.value(name)})
            assert not wrong_setups([right], other), (name, factor)


def test_corrected_recording_is_whole(right: Recording, tmp_path: Path) -> None:
    count = correct(right, Fix(scale={"tilt_x": -1.0}, shift={"motor_current": 0.25}), tmp_path / "new")
    made = Recording.open(tmp_path / "new")
    assert count == len(made.measurement) == len(right.measurement) - 500
    assert made.environment == [replace(e, time=max(e.time - 0.25, 0.0)) for e in right.environment]
    assert made.bench_text == right.bench_text
    assert len(made.setpoint) == len(right.setpoint)
    assert np.array_equal(made.measurement["tilt_x"], -right.measurement["tilt_x"][500:])
    assert np.array_equal(made.measurement["motor_current"], right.measurement["motor_current"][:-500])
    assert not made.topics.get("/gyrowheel/drag_estimate")


@pytest.mark.parametrize(
    ("cure", "what"),
    [
        (Fix(), "nothing to correct"),
        (Fix(scale={"tilt": 2.0}), "did you mean"),
        (Fix(scale={"tilt_x": 0.0}), "out of range"),
        (Fix(exchange=(("tilt_x", "tilt_x"),)), "twice"),
        (Fix(shift={"tilt_x": 1e4}), "nothing is left"),
    ],
)
def test_invalid_corrections_are_refused(right: Recording, cure: Fix, what: str) -> None:
    with pytest.raises(InputError, match=what):
        corrected(right.measurement, cure)


@pytest.mark.parametrize("factors", [{"rotor_inertia_z": 1.5}, dict.fromkeys(("x", "y", "z"), 2.0)])
def test_other_machine_is_recognised_by_its_inertia(
    right: Recording, factors: dict[str, float], tmp_path: Path
) -> None:
    stated = Bench.load()
    names = {key if "_" in key else f"rotor_inertia_{key}": by for key, by in factors.items()}
    text = (resources.files("gyrowheel_sim") / "config/bench.yaml").read_text()
    for name, by in names.items():
        value = stated.value(name)
        text = re.sub(rf"(  {name}: {{value: )[^,]*", rf"\g<1>{by * value:.6e}", text)
    (tmp_path / "other.yaml").write_text(text)
    (tmp_path / "slow.yaml").write_text(SLOW)
    other = gw.simulate(tmp_path / "slow.yaml", bench=tmp_path / "other.yaml", machine=2).data
    # neither tells what it is of
    unnamed = [
        replace(r, environment=[replace(e, machine="") for e in r.environment]) for r in (right, other)
    ]
    (found,) = wrong_setups(unnamed, stated)
    assert (found.kind, found.recording) == ("another_machine", str(other.path))
    assert found.value == pytest.approx(max(factors.values()), rel=0.06)
    assert not wrong_setups(unnamed, stated, mixed=True)


@pytest.mark.slow
def test_recordings_of_one_machine_belong_together(right: Recording, bench: Bench) -> None:
    effects = {"gravity_offset": {"G": 0.012}}
    others = [
        gw.simulate(plan, effects=effects, machine=11).data for plan in ("cone", "coast_down", "preheat")
    ]
    unnamed = [
        replace(r, environment=[replace(e, machine="") for e in r.environment]) for r in (right, *others)
    ]
    assert not wrong_setups(unnamed, bench)


def test_a_first_block_of_one_sample_has_the_speed_of_the_next(right: Recording) -> None:
    """Nearly all samples lack one of the readings: the first block has one that is whole, and none before it."""
    rows = right.measurement[:2000].copy()
    kept = [0, 40, 58]
    lost = np.setdiff1d(np.arange(len(rows)), kept)
    rows["motor_current"][lost] = np.nan
    found = blocks_of(replace(right, measurement=rows))
    column = NAMES.index("motor_current")
    assert found[0, column] == rows["motor_current"][0]
    step = np.diff(rows["spin_angle"][kept[:2]])[0]
    step -= 2.0 * math.pi * round(step / (2.0 * math.pi))
    time = np.diff(rows["stamp_ns"][kept[:2]])[0] * 1e-9
    assert found[0, NAMES.index("spin_angle")] == pytest.approx(step / time, rel=1e-6)
