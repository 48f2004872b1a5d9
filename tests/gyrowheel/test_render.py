"""How results look on the terminal."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import RenderableType

from gyrowheel.air_flow.page import check_page, table_page
from gyrowheel.catalogue.page import (
    bench_page,
    effect_list,
    effect_page,
    parameter_error_page,
    plan_list,
    plan_page,
)
from gyrowheel.catalogue.parameter_error import parameter_error
from gyrowheel.comparison.page import channel_table
from gyrowheel.diagnosis.page import detection_limits, following
from gyrowheel.diagnosis.page import diagnosis_page as rendered
from gyrowheel.drag_comparison.page import drag_page
from gyrowheel.models.page import model_page
from gyrowheel.show.contract import diagnosis_json
from gyrowheel.show.error_table import fall
from gyrowheel.show.formulas import pretty
from gyrowheel.show.layout import commands, figures_table, plain_text, words_table
from gyrowheel.show.sentences.diagnosis import (
    ERROR_TITLES,
    form_sentence,
    prior_sentences,
    verdict_sentence,
)
from gyrowheel.show.sentences.proof import proof_sentence
from gyrowheel_air.check import check_table
from gyrowheel_air.table import TorqueTable
from gyrowheel_analysis.channels import LISTED
from gyrowheel_analysis.compare import ChannelMetrics
from gyrowheel_analysis.diagnosis.estimates import Beyond, Estimate
from gyrowheel_analysis.diagnosis.findings import TieReport
from gyrowheel_analysis.diagnosis.proof_result import ChannelCheck, Proof
from gyrowheel_analysis.drag.estimate import Estimate as DragEstimate
from gyrowheel_analysis.fitting.fit import Prior
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.windows import Coverage
from gyrowheel_analysis.residuals.error_table import ErrorRow
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.quantities import decimal, fixed, minus, quantity, seconds, short, span, with_error
from gyrowheel_core.units import RPM, unit_for
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, effect_from_text, registry
from gyrowheel_sim.effects.complex_parts import split
from gyrowheel_sim.effects.formula import read

from .findings import AMBIGUOUS, UNKNOWN, diagnosis, finding, limit, tie

VERDICTS = {
    "nothing": diagnosis("nothing_missing"),
    "effect": diagnosis("effect", finding("windage")),
    "two": diagnosis("effect", finding("windage"), finding("coil_tilt", size=-1.0)),
    "ambiguous": AMBIGUOUS,
    "no test": diagnosis("ambiguous", finding("aero_cross", tie("windage", None))),
    "unknown": UNKNOWN,
    "insufficient": diagnosis("insufficient_data", error=None, nuisance={}, limits=(), where=()),
}


def text_of(parts, width: int = 80) -> str:
    return f"{plain_text(parts, width)}\n"


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
        (fixed(-0.0), "0.00"),
        (with_error(-0.0001, 0.1, "N*m/rad^3"), "0.00 ± 0.10 N·m/rad³"),
        (decimal(-0.3, 0), "0"),
        (decimal(-12.34, 1), "−12.3"),
        (decimal(12.34, 1, sign=True), "+12.3"),
        (decimal(math.nan, 1), "–"),
        (minus("T1 -0.3 %, (-2) and 1e-5 of k-omega, 3-4"), "T1 −0.3 %, (−2) and 1e-5 of k-omega, 3-4"),
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
def test_numbers_have_readable_units_and_digits(shown: str, expected: str):
    assert shown == expected


def test_every_unit_in_use_has_a_sign():
    units = {c.unit for effect in registry().values() for c in effect.coefficients}
    units |= {p.unit for p in Bench.load().parameters.values()}
    assert not [unit for unit in units if set("*^") & set(unit_for(1.0, unit).label)]


def test_torques_of_a_small_bench_are_shown_in_a_smaller_unit():
    row = ErrorRow({"tilt_x": 1.2e-5, "tilt_y": 1.1e-5, "spin": 2.1e-6}, 70.0)
    after = ErrorRow({"tilt_x": 4e-7, "tilt_y": 6e-7, "spin": 2.1e-6}, 0.7)
    floor = ErrorRow({"tilt_x": 6.6e-7, "tilt_y": 6.6e-7, "spin": 3.8e-6}, 1.0)
    text = fall(row, after, floor, "it")
    assert text.endswith("tilt x, where the error falls most, from 12.0 to 0.400 µN·m (noise 0.660).")
    large = ErrorRow({name: 100.0 * value for name, value in floor.rms.items()}, 1.0)
    assert "mN·m" in fall(row, after, large, "it")
    assert "rises most" in fall(after, row, floor, "it")
    # one channel falls while all of them together rise
    mixed = ErrorRow({**row.rms, "spin": 1e-9}, 140.0)
    assert "falls" not in fall(row, mixed, floor, "it")


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
    shown = [law.expression for law in effect.laws]
    for state in effect.states:
        shown += [state.rate, state.start] if state.start != 0 else [state.rate]
    names = [*(c.name for c in effect.coefficients), *(state.name for state in effect.states)]
    two = [state.name for state in effect.states if state.complex]
    for part, expression in zip(pretty(effect.formula).split("; "), shown, strict=True):
        typed = read(part.partition(" = ")[2], names, two=two).expression
        # |z|² is shown for z z*
        assert split(typed) == split(expression)


def test_a_model_shows_a_user_defined_effect():
    own = effect_from_text("stator_pull: torque = -k*r*z; k [N*m/rad]")
    model = Model(Bench.load(), effects={"stator_pull": {"k": 0.02}}, declared={"stator_pull": own})
    words = " ".join(text_of(model_page(model)).split())
    assert "stator_pull k 20 mN·m/rad" in words
    assert "torque on the rotor = −k·Ω·z/Ω₀" in words


#: Everything of a size that takes as much room as there can be.
COMPARED: Any = SimpleNamespace(
    channels={
        name: ChannelMetrics(0.0543e-3, 0.0123e-3, 99.9, 0.999, 1.0, 0.0, 0.0, 12345.6) for name in LISTED
    },
    raw_rms=dict.fromkeys(LISTED, 0.0543e-3),
)
WIDE = np.array([-0.0123, -0.0123, -0.0123])
ESTIMATE = DragEstimate(
    stamp_ns=1_000_000_000,
    segment=110,
    settled=True,
    duration=1.5,
    tilt_x=-0.0523,
    tilt_y=-0.0523,
    spin_rate=408.4,
    dc_voltage=np.array([-1.0123, -1.0123, 11.234]),
    dc_voltage_std=np.full(3, 1e-3),
    motor_current=0.1,
    motor_current_std=1e-3,
    reference_segment=109,
    voltage_increment=np.array([-1.0123, -1.0123, -3.1234]),
    voltage_increment_std=np.full(3, 1e-3),
    simulated_voltage_increment=np.array([-1.0123, -1.0123, -3.1234]),
    calibrated=False,
    measured_torque=WIDE,
    measured_torque_std=np.full(3, 1e-4),
    constants_std=np.full(3, 1e-5),
    simulated_torque=WIDE,
    simulated_air_torque=WIDE,
    residual=WIDE,
)
SHIPPED_TABLES: dict[str, Callable[[], Iterable[RenderableType]]] = {
    **{f"bench {name}": partial(bench_page, Bench.load(name)) for name in ("gyrowheel", "dtg")},
    "effects": lambda: effect_list(registry().values()),
    **{f"effect {e.name}": partial(effect_page, e) for e in registry().values()},
    **{
        f"error {name}": partial(parameter_error_page, parameter_error(name, Bench.load()))
        for name in ERROR_TITLES
    },
    "plans": lambda: plan_list(map(Plan.load, Plan.shipped())),
    **{f"plan {name}": partial(plan_page, Plan.load(name)) for name in Plan.shipped()},
    "limits": lambda: detection_limits(
        [replace(each, value=1.9 * each.usual[1]) for e in registry() for each in limit(e, 1.0)]
    ),
    "channels": lambda: [channel_table(COMPARED)],
    "estimates": lambda: drag_page([ESTIMATE] * 3),
    "air table": lambda: table_page(TorqueTable.load()),
    "air check": lambda: check_page(TorqueTable.load(), check_table(TorqueTable.load())),
}


@pytest.mark.parametrize("width", [80, 110])
@pytest.mark.parametrize("name", SHIPPED_TABLES)
def test_no_table_is_truncated(name: str, width: int):
    shown = text_of(SHIPPED_TABLES[name](), width)
    assert "…" not in shown
    lines = shown.splitlines()
    assert all(len(line) <= width for line in lines if "gyrowheel " not in line)
    assert not [line for line in lines if re.search(r"[ (]-\d", line)]
    # whatever is a word or a number stands in one piece
    pieces = set(shown.split())
    assert not set(text_of(SHIPPED_TABLES[name](), 400).split()) - pieces - {"─" * n for n in range(400)}


@settings(max_examples=60, deadline=None)
@given(st.data(), st.integers(12, 80))
def test_tables_keep_every_cell_on_any_terminal(data: st.DataObject, width: int):
    word = st.text("abcxyz0189.−", min_size=1, max_size=30)
    count = data.draw(st.integers(1, 6))
    rows = data.draw(st.lists(st.lists(word, min_size=count, max_size=count), min_size=1, max_size=4))
    figures = figures_table("", *[""] * (count - 1))
    words = words_table(*[""] * count, whole=range(0, count, 2))
    for table in (figures, words):
        for row in rows:
            table.add_row(*row)
        shown = text_of([table], width)
        assert "…" not in shown
        lines = shown.splitlines()
        assert all(len(line) <= width for line in lines)
        for cell in (cell for row in rows for cell in row):
            if len(cell) <= width - 4:  # it has room in a line of its own
                assert any(cell in line for line in lines)
            else:
                assert cell in "".join(shown.split())


def test_effects_that_show_only_at_unrealistic_sizes_are_listed_as_not_visible():
    (plain,) = limit("aero_cross", 0.09)
    far = [
        *limit("external_damping", 0.12),
        *limit("runout", math.radians(23.0)),
        *limit("inertia_anisotropy", 3.1e-3),
    ]
    words = " ".join(text_of(detection_limits([plain, *far])).split())
    assert "aero_cross c 90 mN·m/rad" in words
    assert "Not visible at any realistic size: external_damping, runout, inertia_anisotropy." in words
    assert "e+" not in words


@pytest.mark.parametrize("width", [80, 110])
@pytest.mark.parametrize("name", VERDICTS)
def test_every_verdict_can_be_shown(name: str, width: int):
    found = VERDICTS[name]
    shown = text_of(rendered(found), width)
    assert all(len(line) <= width for line in shown.splitlines())
    words = " ".join(shown.replace("│", " ").split())
    assert verdict_sentence(found).split(":")[0] in words
    if found.limits:
        assert "gravity_offset G 11 mN·m/rad 0.8 .. 6 mN·m/rad not visible" in words
        assert "Not visible at any realistic size: tilt_bias." in words
        assert "coil_constant 20.600 ± 0.050 mN·m/V 20.00 ± 0.40 mN·m/V" in words
        assert "motor_constant" not in words


def test_verdicts_are_plain_sentences():
    assert (
        verdict_sentence(VERDICTS["effect"]) == "An effect is missing: drag of the air on the spin (windage)."
    )
    assert verdict_sentence(VERDICTS["two"]).startswith("Two effects are missing: ")
    either = "either cross torque of the air on the tilted rotor (aero_cross) or additional"
    assert either in verdict_sentence(AMBIGUOUS)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("effect", "An effect may be missing: drag of the air on the spin (windage). This is not proven."),
        ("two", "Two effects may be missing: "),
        ("ambiguous", "Missing: either cross torque of the air on the tilted rotor (aero_cross) or "),
    ],
)
def test_what_unused_data_contradict_is_not_stated_as_proven(name: str, said: str):
    """Once the heading said that an effect is missing, and the line below that this is not consistent."""
    shown = verdict_sentence(
        replace(VERDICTS[name], proof=Proof("check", False, "channel", causes=("spin",)))
    )
    assert shown.startswith(said)
    assert shown.endswith("This is not proven.")
    assert verdict_sentence(
        replace(VERDICTS[name], proof=Proof("check", True, "predicted"))
    ) == verdict_sentence(VERDICTS[name])


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            {},
            "Consistent with check in every channel: error of tilt x 0.123 → 0.0340 mN·m (noise 0.0320), χ²/N 0.969.",
        ),
        (
            {"left_out": "speed", "parts": 5},
            "Consistent in every channel: each of 5 spin rates predicted from the others, error of tilt x 0.123 → "
            "0.0340 mN·m (noise and uncertainty of the prediction 0.0320), χ²/N 0.969.",
        ),
        (
            {"proven": False, "reason": "unfixed", "chi2_per_n": 35.0, "causes": ("shaft_inertia",)},
            "NOT consistent with check: χ²/N 35.0, where chance allows 1.30: shaft_inertia is not known well enough "
            "from what was fitted.",
        ),
        (
            {
                "proven": False, "reason": "differs", "chi2_per_n": 35.0, "causes": ("rotor_inertia_z",),
                "value": 3.6e-3, "fitted": 1.78e-3, "unit": "kg*m^2",
            },
            "NOT consistent with check: χ²/N 35.0, where chance allows 1.30; it would take rotor_inertia_z 3600 mg·m² "
            "there instead of 1780 mg·m²: another machine, one that has changed, or a law that does not hold "
            "there.",
        ),
        (
            {"proven": False, "reason": "resembles", "chi2_per_n": 35.0, "causes": ("gravity_offset",)},
            "NOT consistent with check: χ²/N 35.0, where chance allows 1.30; what is left there looks like "
            "gravity_offset.",
        ),
        (
            {
                "proven": False, "reason": "channel", "causes": ("motor_voltage",), "speed": 3500.0 * RPM,
                "channels": (ChannelCheck("motor_voltage", 1.1, 1.8, 4.41, 2.25),),
            },
            "NOT consistent with check: motor voltage 2.10 times its noise, where chance allows 1.50; largest at "
            "3500 rpm.",
        ),
        (
            {"proven": False, "reason": "dependence", "causes": ("spin", "speed")},
            "NOT consistent with check: what is left of the motor torque depends on the spin rate.",
        ),
        (
            {"smallest": 1.49},
            "Consistent with check in every channel: error of tilt x 0.123 → 0.0340 mN·m (noise 0.0320), χ²/N 0.969; "
            "detection limit: 1.49 times the noise of a channel.",
        ),
        (
            {"proven": None, "reason": "no_gain", "before": 3.5e-5},
            "Not tested with check: what was found hardly changes the prediction, error of tilt x 0.0350 → 0.0340 mN·m",
        ),
        ({"proven": None, "reason": "not_tried"}, "Not tested on anything that was not fitted"),
    ],
)  # fmt: skip
def test_every_verdict_ends_with_the_test_on_unseen_data(changes: dict[str, Any], expected: str):
    proof = Proof(
        "check", True, "predicted", chi2_per_n=0.969, allowed=1.3, channel="tilt_x", before=1.23e-4, after=3.4e-5,
        noise=3.2e-5,
    )  # fmt: skip
    assert proof_sentence(replace(proof, **changes)).startswith(expected)


def test_unusual_values_are_reported_first():
    far = Beyond("unusual", "windage", "w", 0.0104, 0.0013, "N*m", 8.0)
    alone = verdict_sentence(replace(VERDICTS["effect"], beyond=(far,)))
    assert alone.startswith(
        "windage w of 10.4 mN·m is 8.0 times the largest usual size. An effect is missing"
    )
    several = verdict_sentence(replace(VERDICTS["two"], verdict="unknown", beyond=(far,)))
    assert several.startswith(
        "windage w of 10.4 mN·m is 8.0 times the largest usual size. That is no explanation"
    )
    never = Beyond("impossible", "flexure_stiffness_x", "", -0.02, 0.0, "N*m/rad", 0.0)
    assert "impossible" in verdict_sentence(replace(VERDICTS["nothing"], verdict="unknown", beyond=(never,)))


def test_undetectable_effects_are_named_if_nothing_is_found():
    quiet = VERDICTS["nothing"]
    assert verdict_sentence(replace(quiet, limits=limit("windage", 1e-4))).startswith("Nothing is missing:")
    sentence = verdict_sentence(replace(quiet, limits=limit("gravity_offset", 0.011)))
    assert sentence.startswith("Nothing shows:")
    assert sentence.endswith("A gravity_offset of a usual size could hide in them.")


def test_a_wrong_effect_of_the_model_is_distinguished_from_a_missing_one():
    own, new = finding("aero_cross"), finding("windage")
    wrong = replace(
        own, in_model={name: Estimate(2.0e-3, 1e-4, e.unit) for name, e in own.coefficients.items()}
    )
    alone, both = diagnosis("effect", wrong), diagnosis("effect", new, wrong)
    assert verdict_sentence(alone) == "The size of aero_cross in the model disagrees with these recordings."
    assert verdict_sentence(both).startswith(
        "An effect is missing: drag of the air on the spin (windage). The size of"
    )
    assert "in the model 2.00 ± 0.10 mN·m/rad" in " ".join(text_of(rendered(both)).split())


def test_excluded_data_are_reported():
    part = Coverage(60.0, 30.0, {"of a kind": 2.0, "of another": 8.0, "of a third": 0.01})
    words = " ".join(text_of(rendered(replace(AMBIGUOUS, coverage=part))).split())
    said = "30 of 40 s of steady motion take part (of 60 s recorded); left out: 8.0 s of another, 2.0 s of a kind."
    assert said in words
    nearly = replace(AMBIGUOUS, coverage=Coverage(60.0, 39.0, {"of a kind": 1.0}))
    assert "take part" not in text_of(rendered(nearly))


def test_ties_name_the_separating_test_or_report_that_no_test_separates_them():
    assert "Plan air_density separates them, expected Δχ² 88" in " ".join(
        text_of(rendered(AMBIGUOUS)).split()
    )
    assert "No test on this bench separates them" in " ".join(text_of(rendered(VERDICTS["no test"])).split())


def test_the_next_command_stays_on_one_line(tmp_path):
    folder = tmp_path / "a folder with a very long name that does not fit into eighty columns"
    command = following(VERDICTS["effect"], [folder / "drag"], [folder / "other"], folder / "model.yaml")
    assert command is not None
    assert f"--fit '{folder}/drag' --validate '{folder}/other'" in command
    assert f"  {command}" in text_of(commands("Next", command)).splitlines()
    assert following(VERDICTS["nothing"], [folder], [], folder) is None
    test = following(AMBIGUOUS, [folder / "drag"], [], folder / "model.yaml")
    assert test is not None
    assert "gyrowheel up --plan air_density --record" in test


def test_a_known_effect_next_to_an_unknown_one_is_named():
    assert verdict_sentence(UNKNOWN) == (
        "Something is missing that no known effect explains; proposed formula: It grows with the tilt squared."
    )
    both = replace(UNKNOWN, effects=(finding("windage"),))
    assert verdict_sentence(both).startswith(
        "Besides drag of the air on the spin (windage), something is missing that no known effect explains"
    )
    failed = replace(both, proof=Proof("check", False, "misfit"))
    assert verdict_sentence(failed).startswith(
        "Besides what looks like drag of the air on the spin (windage), "
    )


def test_wrong_values_of_a_model_are_distinguished_from_missing_effects():
    wrong = replace(finding("windage"), name="stiffness_error", effect_title="", effect_sentence="")
    found = diagnosis("effect", wrong)
    assert verdict_sentence(found) == "The flexure stiffness differs from the bench file (stiffness_error)."
    assert "beyond five of its stated uncertainties" in text_of(rendered(found))


def test_formulas_that_describe_the_recordings_as_well_are_shown_with_the_test_and_the_command():
    (form,) = UNKNOWN.free_form
    other = replace(form, name="lobes", formula="rotor_torque = a*conj(z)", description="torque with lobes")
    ties = (
        TieReport("lobes", "", 0.01, "cone", 40.0, 0.5, form=other),
        TieReport("lobes", "", 3.25, None, None, None, form=other),
    )
    found = replace(UNKNOWN, free_form=(replace(form, name="power", ties=ties),))
    shown = " ".join(text_of(rendered(found)).replace("│", " ").split())
    assert "2 other formulas describe these recordings as well" in shown
    assert "could also be lobes, torque with lobes: χ² is no worse. Plan cone separates them" in shown
    assert "χ² is only 3.2 worse. No test on this bench separates them." in shown
    assert "--formula 'lobes: rotor_torque = a*conj(z)'" in shown
    (told,) = diagnosis_json(found)["free_form"]
    assert [tie["formula"] for tie in told["ties"]] == [other.formula] * 2
    assert [tie["separating_plan"] for tie in told["ties"]] == ["cone", None]


def test_an_exponent_of_a_user_defined_effect_is_a_number_and_its_gain_a_part():
    own = {
        "q": Estimate(6.98, 0.55, "1", Prior(6.4, 1.0), (7.1, 0.6), "assumed"),
        "g": Estimate(0.02, 0.001, "1"),
    }
    assert prior_sentences("mine", own) == [
        "q is 7.10 ± 0.60 by the data alone; the estimate includes the prior 6.4 ± 1.0 (assumed)"
    ]
    found = diagnosis("effect", replace(finding("windage"), name="mine", coefficients=own))
    shown = " ".join(text_of(rendered(found)).split())
    assert "q 6.98 ± 0.55" in shown
    assert "g 2.00 ± 0.10 %" in shown


def test_free_forms_show_edges_in_degrees_and_fitted_exponents():
    edge = replace(
        UNKNOWN.free_form[0],
        description="torque along the tilt beyond an edge",
        coefficients={"a": Estimate(1e-3, 1e-5, "N*m"), "p": Estimate(0.7, 0.01, "1")},
        places={"p": Estimate(math.radians(3.5), math.radians(0.05), "rad")},
    )
    shown = " ".join(text_of(rendered(replace(UNKNOWN, free_form=(edge,)))).replace("│", " ").split())
    assert "torque along the tilt beyond 3.500 ± 0.050 deg" in shown
    assert "p 3.500 ± 0.050 deg (0.700 ± 0.010 of the reference)" in shown
    power = replace(
        edge,
        description="torque along or across the tilt, |tilt|^k, speed^q",
        coefficients={"k": Estimate(2.125, 0.01, "1"), "q": Estimate(0.5, 0.01, "1")},
        places={},
    )
    assert form_sentence(power) == "torque along or across the tilt, |tilt|^2.12, speed^0.50"
