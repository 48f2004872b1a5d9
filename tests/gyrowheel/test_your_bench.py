"""User-defined bench files: copied from another one, all errors at once, their capability; the guide, step by step."""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path

import pytest

from gyrowheel.catalogue.api import new_bench, reach
from gyrowheel.catalogue.page import reach_sentences
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

from .helpers import Shell

DEFAULT = Bench.load()
PAGE = (Path(__file__).resolve().parents[2] / "docs" / "your_bench.md").read_text(encoding="utf-8")


def like(**factors: float) -> Bench:
    return DEFAULT.with_values({name: factor * DEFAULT.value(name) for name, factor in factors.items()})


def said(bench: Bench) -> str:
    return " ".join(reach_sentences(reach(bench)))


@pytest.mark.slow
def test_the_guide_leads_from_a_bench_file_to_a_diagnosis(
    gyrowheel: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every command of the page, and the change of the file that it shows."""
    monkeypatch.chdir(tmp_path)
    (change,) = re.findall(r"<!-- change: (\S+) -->\n```yaml\n(.*?)```", PAGE, re.DOTALL)
    commands = re.findall(r"^\$ gyrowheel (.*)$", PAGE, re.MULTILINE)
    results = []
    for number, command in enumerate(commands):
        results.append(gyrowheel.good(*shlex.split(command)))
        if number == 0:
            text = Path(change[0]).read_text(encoding="utf-8")
            for line in change[1].splitlines():
                name = line.split(":")[0]
                text, count = re.subn(rf"^{name}:.*$", line, text, flags=re.MULTILINE)
                assert count == 1, name
            Path(change[0]).write_text(text, encoding="utf-8")
    heavy = Bench.load("heavy.yaml")
    assert heavy.axial_inertia == pytest.approx(DEFAULT.axial_inertia + DEFAULT.value("rotor_inertia_z"))
    _, page, plan, run, _, found = results
    assert "less than the 8 deg/s of the shipped plans" in " ".join(page.out.split())
    assert "One minute that shows most effects (bench heavy)" in plan.out
    assert "plan quick for the bench heavy: tilt rate 8 → " in run.err
    assert "An effect is missing: cross torque of the air" in found.out


@pytest.mark.parametrize("name", Bench.shipped())
def test_a_copied_bench_file_describes_the_same_machine(tmp_path: Path, name: str) -> None:
    file, old = tmp_path / "mine.yaml", Bench.load(name)
    new_bench(file, name)
    new = Bench.load(file)
    assert (new.name, new.spin_loop, new.gains, new.references) == (
        "mine",
        old.spin_loop,
        old.gains,
        old.references,
    )
    assert list(new.parameters) == list(old.parameters)
    for p in old.parameters.values():
        own = new.parameters[p.name]
        assert own.value == pytest.approx(p.value, rel=1e-12, abs=0.0)
        assert own.uncertainty == pytest.approx(p.uncertainty, rel=1e-6, abs=0.0)
        assert (own.unit, own.group, own.description) == (p.unit, p.group, p.description)
        assert p.source in own.source
        assert f"# {p.description}" in file.read_text(encoding="utf-8")
    with pytest.raises(InputError, match="exists; name a new file"):
        new_bench(file, name)


def test_all_errors_of_a_bench_file_are_reported_at_once(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    new_bench(file)
    good = file.read_text(encoding="utf-8")

    def refusal(*changes: tuple[str, str]) -> str:
        text = good
        for before, after in changes:
            assert before in text
            text = text.replace(before, after, 1)
        with pytest.raises(InputError) as caught:
            Bench.from_text(text, origin="FILE")
        return str(caught.value)

    assert refusal(
        ("rotor_inertia_z:", "rotor_inertia_zz:"),
        ("coil_constant: {value: 0.02", "coil_constant: {value: -0.02"),
        ("motor_resistance: {value: 1.5, unit: ohm", "motor_resistance: {value: 1.5, unit: kg"),
    ) == (
        "FILE: parameters.rotor_inertia_zz: no such parameter; did you mean rotor_inertia_z?; "
        "coil_constant: -0.02 is out of range; allowed: > 0; "
        "motor_resistance.unit: 'kg' cannot be converted; allowed: units such as ohm; missing rotor_inertia_z"
    )
    text = refusal(
        ("schema: 1", "schema: 1\ncolour: red"),
        ("tilt_bias_x: {value", "tilt_bias_x: {vlaue"),
        ("supply_voltage:", "suply_voltage:"),
        (
            "  # gains: {tilt_bandwidth: 12, tilt_integral: 30",
            "  gains: {tilt_bandwith: 12, tilt_integral: -30",
        ),
    )
    for part in (
        "colour: no such field",
        "tilt_bias_x.vlaue: no such field; did you mean value?",
        "suply_voltage: no such parameter; did you mean supply_voltage?",
        "controller.gains: tilt_bandwith: no such gain; did you mean tilt_bandwidth?",
        "tilt_integral: -30.0 is out of range; allowed: >= 0",
    ):
        assert part in text


def test_gains_of_the_file_are_those_of_the_loops(tmp_path: Path) -> None:
    from gyrowheel_control.loops.controller import Gains, controller_parameters

    file = tmp_path / "mine.yaml"
    new_bench(file)
    text = file.read_text(encoding="utf-8").replace(
        "spin_loop: pi", "spin_loop: pi\n  gains: {spin_proportional: 9}"
    )
    bench = Bench.from_text(text, origin="FILE")
    assert bench.gains == Gains(spin_proportional=9.0)
    assert DEFAULT.gains == Gains()
    faster, usual = (controller_parameters(own, own.gains) for own in (bench, DEFAULT))
    assert faster.spin_proportional == pytest.approx(9.0 / 6.34 * usual.spin_proportional)


def test_unreachable_speeds_and_tilts_are_reported_with_their_reason() -> None:
    usual = reach(DEFAULT)
    assert (usual.largest_tilt, math.isinf(usual.top_speed)) == (DEFAULT.value("tilt_limit"), True)
    assert [own.spin_rate / RPM for own in usual.speeds] == pytest.approx([1000, 3500, 4000])
    top = usual.speeds[-1]
    # known without a model of anything else: momentum times rate, and the back-EMF
    assert top.slew * top.momentum == pytest.approx(0.75 * 10.0 * 0.02)
    assert top.motor_volts == pytest.approx(0.03 * top.spin_rate, rel=0.02)
    assert top.nutation == pytest.approx(112.0, rel=0.01)
    assert "cannot" not in said(DEFAULT)
    stiff = like(flexure_stiffness_x=30, flexure_stiffness_y=30)
    assert reach(stiff).largest_tilt < 2.0 * DEG
    assert "5 deg cannot be held. At 4000 rpm the flexures" in said(stiff)
    weak = like(supply_voltage=0.4)
    assert 3000.0 < reach(weak).top_speed / RPM < 3600.0
    assert "That is more than the supply gives: it holds up to 33" in said(weak)
    heavy = said(like(rotor_inertia_x=2, rotor_inertia_y=2, rotor_inertia_z=2))
    assert "From 3500 rpm on that is less than the 8 deg/s of the shipped plans" in heavy
    assert "less than the 1000 of the shipped plans" in heavy
    assert "fewer than ten of the 500 samples" in said(like(sample_period=4))
    slow = reach(like(spin_rate_minimum=0.02, spin_rate_maximum=0.02, spin_rate_reference=0.02))
    assert slow.speeds[0].slew > top.slew


def test_incompatible_options_are_refused(gyrowheel: Shell, tmp_path: Path) -> None:
    result = gyrowheel("bench", "--like", "dtg")
    assert result.code == 2
    assert "--like: is only of use with --new" in result.err
    shown = gyrowheel.good("bench", "--new", tmp_path / "mine.yaml", "--like", "dtg").out
    assert f"gyrowheel bench --bench {tmp_path / 'mine.yaml'} --reach" in shown
    found = gyrowheel.good("bench", "--bench", tmp_path / "mine.yaml", "--reach", "--json", "-").json
    assert len(found["reach"]["speeds"]) == 3
    assert found["name"] == "mine"
