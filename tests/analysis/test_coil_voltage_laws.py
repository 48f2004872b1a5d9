"""Laws that depend on the voltages of the coils, which themselves follow from the torques of all laws."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel_analysis.balance.balance import ActiveEffect, Balance
from gyrowheel_analysis.diagnosis.free_forms import forms, further_forms, kind_of
from gyrowheel_analysis.diagnosis.selection import rank
from gyrowheel_analysis.diagnosis.unknown import family
from gyrowheel_analysis.fitting.fit import Point, Term
from gyrowheel_analysis.fitting.preparation import prepare
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.segmentation import planned_windows
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.user_defined_line import typed_effect
from gyrowheel_sim.plant.scenario import Scenario

from .machines import hidden_machine, record

BENCH = Bench.load()
SATURATION = typed_effect("saturation: -c*(re(V_coil)^3 + i*im(V_coil)^3); c = 2e-5 [N*m/V^3]")
MAGNETISED = typed_effect(
    "magnetised: coil_gain = g*s; d(s)/dt = (abs(V_coil) - s)/tau; tau = 2 +- 1 [s]; g = 0.008 [1/V]"
)


def test_the_torque_of_a_voltage_is_that_of_coil_and_law() -> None:
    """By an independent solution: the voltage V of a coil at every instant solves k V - c V^3 = T."""
    balance = Balance(planned_windows(Plan.load("check"), BENCH), BENCH)
    values, size = BENCH.values(), SATURATION.defaults()["c"]
    required = balance.instants(values, []).coil.ravel()
    found = balance.instants(values, [ActiveEffect(SATURATION, SATURATION.defaults())])
    volts = found.quantities["V_coil"].ravel()
    assert np.abs(required).max() > 0.1  # the law takes 2 % of it
    for torque, answer in ((required.real, volts.real), (required.imag, volts.imag)):
        left = values["coil_constant"] * answer - size * answer**3 - torque
        # the law acts across the spin axis, the coils in the case: a part of the square of the tilt
        assert np.abs(left).max() < 0.005 * size * np.abs(answer).max() ** 3


def test_a_gain_by_the_sign_of_the_voltage_has_a_form() -> None:
    """An amplifier that gives 2 % more for one sign adds the amount of each voltage; once no form described it."""
    law = typed_effect("gain: rotor_torque = a*(abs(re(V_coil)) + i*abs(im(V_coil))); a = 4e-4 [N*m/V]")
    plain = Problem.of([Balance(planned_windows(Plan.load("check"), BENCH), BENCH)], BENCH)
    (balance,) = plain.balances
    rows = plain.predict(Point((Term("gain", law),), np.zeros(plain.count), {"gain": law.defaults()}))
    problem = replace(plain, prediction=plain.prediction.with_measured([balance.with_measured(rows)]))
    null = problem.fit(())
    pool = [t for t in family(problem, (*forms(), *further_forms())) if t.name.startswith("coil_")]
    fits = {t.name: problem.fit((t,), null) for _, t in rank(problem, null, pool)[:4]}
    best = min(fits, key=lambda name: fits[name].chi2)
    assert kind_of(best) == "coil_even"
    assert fits[best].chi2 < 0.01 * null.chi2
    assert fits[best].coefficients[best]["a"] == pytest.approx(4e-4, rel=0.02)


@pytest.mark.slow
def test_typed_laws_of_the_coil_voltage_are_fitted_and_explain_the_recording(tmp_path: Path) -> None:
    bare, effects = hidden_machine(5, {}), (SATURATION, MAGNETISED)
    values = {effect.name: effect.defaults() for effect in effects}
    machine = Scenario(bare.values, values, bare.noise_seed, {effect.name: effect for effect in effects})
    problem = prepare([record(tmp_path, "run", machine, "quick")], Model.new()).problem
    found = problem.fit([Term(effect.name, effect) for effect in effects])
    for effect in effects:
        assert (
            problem.fit([Term(own.name, own) for own in effects if own is not effect]).chi2 - found.chi2
            > 300.0
        )
        for name, true in values[effect.name].items():
            distance = abs(found.coefficients[effect.name][name] - true)
            assert distance < 4.0 * found.standard_error(effect.name, name), name
    white = problem.noise.whiten(found.residual)
    assert float(white @ white) / len(white) < 1.44


@pytest.mark.parametrize("target", ["tilt_reading", "case_rate", "inertia_difference", "tilt_delay"])
def test_what_precedes_the_coil_voltage_cannot_depend_on_it(target: str) -> None:
    with pytest.raises(InputError, match=f"{target} cannot depend on V_coil"):
        typed_effect(f"own: {target} = a*abs(V_coil); a = 1e-4")


@pytest.mark.parametrize(("target", "law"), [("case_rate", "a*z"), ("inertia_difference", "a*abs(z)")])
def test_what_the_balance_takes_as_given_cannot_depend_on_the_tilt(target: str, law: str) -> None:
    with pytest.raises(InputError, match=f"{target} cannot depend on z"):
        typed_effect(f"own: {target} = {law}; a = 1e-4")
