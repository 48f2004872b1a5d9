"""How results look on the terminal."""

from __future__ import annotations

import io
import math
from dataclasses import replace

import pytest
from rich.console import Console

from gyrowheel_analysis.errors import ErrorRow
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction import Coverage
from gyrowheel_bringup.cli.finding import following
from gyrowheel_bringup.render.diagnosis import diagnosis as rendered
from gyrowheel_bringup.render.diagnosis import verdict_sentence
from gyrowheel_bringup.render.errors import fall
from gyrowheel_bringup.render.formulas import pretty
from gyrowheel_bringup.render.layout import show
from gyrowheel_bringup.render.models import model_page
from gyrowheel_bringup.render.quantities import edge, fixed, quantity, seconds, short, span, with_error
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, effect_from_text, registry
from gyrowheel_sim.effects.formula import parse
from gyrowheel_sim.effects.parts import split

from .findings import AMBIGUOUS, UNKNOWN, diagnosis, finding, tie

VERDICTS = {
    "nothing": diagnosis("nothing_missing"),
    "effect": diagnosis("effect", finding("windage")),
    "two": diagnosis("effect", finding("windage"), finding("coil_tilt", size=-1.0)),
    "ambiguous": AMBIGUOUS,
    "no test": diagnosis("ambiguous", finding("aero_cross", tie("windage", None))),
    "unknown": UNKNOWN,
    "insufficient": diagnosis("insufficient_data", error=None, nuisance={}, detection_limits=[], where=[]),
}


def text_of(parts, width: int = 80) -> str:
    stream = io.StringIO()
    show(Console(file=stream, width=width, markup=False), parts)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (with_error(0.02231, 0.00027, "N*m/rad"), "22.31 ± 0.27 mN·m/rad"),
        (with_error(-3.2e-6, 4.5e-7, "N*m*s/rad"), "−3.20 ± 0.45 µN·m·s/rad"),
        (with_error(2.05, 0.03, "1", pure=True), "2.050 ± 0.030"),
        (with_error(0.0562, 0.000996, "1"), "5.62 ± 0.10 %"),
        (with_error(0.1, 0.0, "N*m"), "100 mN·m"),
        (with_error(math.radians(0.2), math.radians(0.01), "rad"), "0.200 ± 0.010 deg"),
        (with_error(0.0012, 0.0345, "N*m"), "1 ± 34 mN·m"),
        (quantity(2.2e-4, "N*m", digits=2), "0.22 mN·m"),
        (quantity(366.519, "rad/s"), "3500 rpm"),
        (span(0.0008, 0.0013, "N*m"), "0.8 .. 1.3 mN·m"),
        (span(0.001, 0.004, "1/K"), "0.1 .. 0.4 %/K"),
        (fixed(0.0), "0.00"),
        (fixed(0.99996), "1.00"),
        (fixed(0.031789), "0.0318"),
        (fixed(math.nan), "–"),
        (short(0.0573), "0.0573"),
        (short(1e7), "1.00e+07"),
        (seconds(0.25), "0.2 s"),
        (seconds(131.2), "2 min 11 s"),
        (seconds(180.0), "3 min"),
    ],
)
def test_numbers_as_people_read_them(shown: str, expected: str):
    assert shown == expected


def test_every_unit_in_use_has_a_sign():
    units = {c.unit for effect in registry().values() for c in effect.coefficients}
    units |= {p.unit for p in Bench.load().parameters.values()}
    assert not [unit for unit in units if set("*^") & set(edge(unit).label)]


def test_torques_of_a_small_bench_are_shown_in_a_smaller_unit():
    row = ErrorRow({"tilt_x": 1.2e-5, "tilt_y": 1.1e-5, "spin": 2.1e-6}, 70.0)
    after = ErrorRow({"tilt_x": 4e-7, "tilt_y": 6e-7, "spin": 2.1e-6}, 0.7)
    floor = ErrorRow({"tilt_x": 6.6e-7, "tilt_y": 6.6e-7, "spin": 3.8e-6}, 1.0)
    text = fall(row, after, floor, "it")
    assert text.endswith("tilt x, where the error falls most, from 12.0 to 0.400 µN·m (noise 0.660).")
    large = ErrorRow({name: 100.0 * value for name, value in floor.rms.items()}, 1.0)
    assert "mN·m" in fall(row, after, large, "it")
    assert "rises most" in fall(after, row, floor, "it")


def test_formulas_are_written_with_signs():
    for effect in registry().values():
        shown = pretty(effect.formula)
        assert not [
            word
            for word in ("Omega", "rho", "theta", "*", "^", "torque =")
            if word in shown.replace("z*", "")
        ]
    assert pretty(registry()["windage"].formula) == "torque along the spin axis = −w·(Ω/Ω₀)ⁿ·(ρ/ρ₀)ⁿ⁻¹"
    assert pretty(registry()["cubic_stiffness"].formula) == "torque of each flexure = −q·θ³"


@pytest.mark.parametrize("effect", registry().values(), ids=lambda effect: effect.name)
def test_a_formula_as_it_is_shown_can_be_typed_in(effect: Effect):
    for part, law in zip(pretty(effect.formula).split("; "), effect.laws, strict=True):
        typed = parse(part.partition(" = ")[2], [c.name for c in effect.coefficients])
        # |z|² is shown for z z*
        assert split(typed) == split(law.expression)


def test_a_model_shows_an_effect_of_its_own():
    own = effect_from_text("stator_pull: torque = -k*r*z; k [N*m/rad]")
    model = Model(Bench.load(), effects={"stator_pull": {"k": 0.02}}, declared={"stator_pull": own})
    words = " ".join(text_of(model_page(model, "m.yaml")).split())
    assert "stator_pull k 20 mN·m/rad" in words
    assert "torque on the rotor = −k·Ω·z/Ω₀" in words


@pytest.mark.parametrize("width", [80, 110])
@pytest.mark.parametrize("name", VERDICTS)
def test_every_verdict_can_be_shown(name: str, width: int):
    found = VERDICTS[name]
    shown = text_of(rendered(found), width)
    assert all(len(line) <= width for line in shown.splitlines())
    words = " ".join(shown.replace("│", " ").split())
    assert verdict_sentence(found).split(":")[0] in words
    if found.detection_limits:
        assert "gravity_offset G 11 mN·m/rad 0.8 .. 6 mN·m/rad not visible" in words
        assert "Not to be seen here, however large: tilt_bias." in words
        assert "coil_constant 20.600 ± 0.050 mN·m/V 20.00 ± 0.40 mN·m/V" in words
        assert "motor_constant" not in words


def test_verdicts_are_plain_sentences():
    assert verdict_sentence(VERDICTS["effect"]) == "An effect is missing: drag of the air on the spin."
    assert verdict_sentence(VERDICTS["two"]).startswith("Two effects are missing: ")
    assert "either cross torque of the air on the tilted rotor or additional" in verdict_sentence(AMBIGUOUS)


def test_what_takes_no_part_is_said():
    part = Coverage(60.0, 30.0, {"of a kind": 2.0, "of another": 8.0, "of a third": 0.01})
    words = " ".join(text_of(rendered(replace(AMBIGUOUS, coverage=part))).split())
    said = "30 of 40 s of steady motion take part (of 60 s recorded); left out: 8.0 s of another, 2.0 s of a kind."
    assert said in words
    nearly = replace(AMBIGUOUS, coverage=Coverage(60.0, 39.0, {"of a kind": 1.0}))
    assert "take part" not in text_of(rendered(nearly))


def test_ties_name_the_test_or_say_that_there_is_none():
    assert "Plan air_density separates them, expected Δχ² 88" in " ".join(
        text_of(rendered(AMBIGUOUS)).split()
    )
    assert "No test on this bench separates them" in " ".join(text_of(rendered(VERDICTS["no test"])).split())


def test_the_next_command_is_never_broken(tmp_path):
    folder = tmp_path / "a folder with a very long name that does not fit into eighty columns"
    command = following(VERDICTS["effect"], [folder / "drag"], [folder / "other"], folder / "model.yaml")
    assert command is not None
    assert f"--fit '{folder}/drag' --validate '{folder}/other'" in command
    assert f"  {command}\n" in text_of(rendered(VERDICTS["effect"], following=command))
    assert following(VERDICTS["nothing"], [folder], [], folder) is None
    test = following(AMBIGUOUS, [folder / "drag"], [], folder / "model.yaml")
    assert test is not None
    assert "gyrowheel up --plan air_density --record" in test
