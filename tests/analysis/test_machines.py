"""What machines of a table share: mean, spread with its interval, and the test of equal machines."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from gyrowheel.catalogue.api import own_effect
from gyrowheel_analysis.diagnosis.diagnose import nuisance_estimates
from gyrowheel_analysis.diagnosis.uncertainty import scatter
from gyrowheel_analysis.fitting.fit import Prior, Unknowns, without_prior
from gyrowheel_analysis.machines import Shared, shared

from .machines import BENCH

Rows = list[dict[str, Any]]
#: Vaccine against tuberculosis, 13 trials: cases and others among treated and among untreated people (Colditz et al.,
#: J. Am. Med. Assoc. 271, 1994), on which Viechtbauer and the package metafor show their methods.
TRIALS = np.array([
    (4, 119, 11, 128), (6, 300, 29, 274), (3, 228, 11, 209), (62, 13536, 248, 12619), (33, 5036, 47, 5761),
    (180, 1361, 372, 1079), (8, 2537, 10, 619), (505, 87886, 499, 87892), (29, 7470, 45, 7232), (17, 1699, 65, 1600),
    (186, 50448, 141, 27197), (5, 2493, 3, 2338), (27, 16886, 29, 17825),
], dtype=float)  # fmt: skip


def fit(values: Any, errors: Any, machines: Any = None) -> Shared:
    """Return what machines share in the only quantity of a table."""
    names = [f"m{k}" for k in range(len(values))] if machines is None else machines
    rows: Rows = [
        {"recording": f"r{k}", "machine": m, "v": float(v), "v.error": float(e)}
        for k, (v, e, m) in enumerate(zip(values, np.broadcast_to(errors, len(values)), names, strict=True))
    ]
    (own,) = shared(rows)
    return own


@pytest.mark.parametrize("scale", [1.0, 1e-9])
@pytest.mark.parametrize("differ", [0.3, 3.0])
def test_equal_errors_have_a_closed_form(differ: float, scale: float) -> None:
    rng = np.random.default_rng(4)
    error, n = 0.7 * scale, 9
    values = 5.0 * scale + rng.normal(0.0, 1.0, n)
    values = 5.0 * scale + (values - values.mean()) / values.std(ddof=1) * differ * scale
    own = fit(values, error)
    variance = (differ * scale) ** 2
    misfit = (n - 1) * variance / error**2
    assert own.mean == pytest.approx(5.0 * scale)
    assert own.standard_error == pytest.approx(math.sqrt(max(variance, error**2) / n))
    assert own.spread == pytest.approx(math.sqrt(max(variance - error**2, 0.0)), rel=1e-4)
    assert own.chance == pytest.approx(chi2.sf(misfit, n - 1))
    # the upper end is that of values that scatter by their errors, where they scatter by less
    largest = [misfit / chi2.ppf(0.975, n - 1), max(misfit, n - 1) / chi2.ppf(0.025, n - 1)]
    assert own.interval == pytest.approx([error * math.sqrt(max(q - 1.0, 0.0)) for q in largest], rel=1e-6)


def test_unequal_errors_agree_with_the_published_fit() -> None:
    """Estimates of metafor's ``rma(yi, vi, method="REML")`` and its ``confint``."""
    ill, well, ill_without, well_without = TRIALS.T
    treated, untreated = ill + well, ill_without + well_without
    ratio = np.log(ill / treated) - np.log(ill_without / untreated)
    variance = 1.0 / ill - 1.0 / treated + 1.0 / ill_without - 1.0 / untreated
    own = fit(ratio, np.sqrt(variance))
    assert own.spread is not None
    assert own.interval is not None
    assert own.mean == pytest.approx(-0.7145, abs=5e-5)
    weight = 1.0 / (variance + 0.3132)
    error = weight.sum() ** -0.5
    assert error == pytest.approx(0.1798, abs=5e-5)  # before the factor of Knapp and Hartung
    excess = math.sqrt(float(weight @ (ratio + 0.7145) ** 2) / 12)
    assert own.standard_error == pytest.approx(error * max(excess, 1.0), rel=1e-3)
    assert own.spread**2 == pytest.approx(0.3132, abs=5e-5)
    assert [end**2 for end in own.interval] == pytest.approx([0.1197, 1.1115], abs=5e-5)
    assert own.chance == pytest.approx(chi2.sf(152.2330, 12), rel=1e-3)
    assert (own.machines, own.recordings, own.repeat_chance) == (13, 13, None)


def test_recordings_of_one_machine_are_one_machine() -> None:
    """The restricted likelihood of all recordings, with the covariance of their errors written out."""
    rng = np.random.default_rng(8)
    counts, errors, noises = (
        [1, 2, 5, 3, 1, 4],
        [0.5, 0.9, 0.6, 0.8, 1.1, 0.7],
        [0.4, 0.3, 0.5, 0.1, 1.1, 0.6],
    )
    of = np.repeat(np.arange(6), counts)
    error, noise = np.repeat(errors, counts), np.repeat(noises, counts)
    same = (of[:, None] == of) * 1.0
    known = np.diag(noise**2) + same * np.sqrt(error**2 - noise**2) * np.sqrt(error**2 - noise**2)[:, None]
    value = 3.0 + rng.multivariate_normal(np.zeros(len(of)), known + same * 1.2**2)
    rows: Rows = [
        {"machine": f"m{of[k]}", "v": 0.0, "v.error": 9.0, "v.data": value[k], "v.data_error": error[k],
         "v.data_scatter": noise[k]}
        for k in range(len(of))
    ]  # fmt: skip
    one = np.ones(len(of))

    def unlikely(spread: float) -> float:
        inverse = np.linalg.inv(known + spread**2 * same)
        rest = value - (one @ inverse @ value) / (one @ inverse @ one)
        return float(rest @ inverse @ rest - np.linalg.slogdet(inverse)[1] + np.log(one @ inverse @ one))

    best = minimize_scalar(unlikely, bounds=(0.0, 10.0), method="bounded", options={"xatol": 1e-9})
    (own,) = shared(rows)
    assert best.x > 0.1
    assert own.spread == pytest.approx(best.x, rel=1e-5)
    inverse = np.linalg.inv(known + best.x**2 * same)
    assert own.mean == pytest.approx((one @ inverse @ value) / (one @ inverse @ one))
    assert (own.machines, own.recordings) == (6, 16)


@pytest.mark.parametrize(
    ("spread", "least", "most"), [(0.0, 0.955, 1.0), (0.4, 0.93, 1.0), (3.0, 0.93, 0.97)]
)
def test_the_interval_contains_the_spread_in_95_of_100_tables(
    spread: float, least: float, most: float
) -> None:
    """Seven machines with errors of 0.2 to 1; 500 tables, whose fraction is known to 0.01."""
    rng = np.random.default_rng(15)
    inside, ends, mean = 0, [], []
    for _ in range(500):
        errors = rng.uniform(0.2, 1.0, 7)
        own = fit(rng.normal(2.0, np.hypot(errors, spread)), errors)
        assert own.interval is not None
        low, high = own.interval
        inside += low <= spread <= high
        ends.append(high)
        mean.append((own.mean - 2.0) / own.standard_error)
    assert least <= inside / 500 <= most
    assert min(ends) > 0.1
    assert 0.9 < np.std(mean) < 1.3  # Student's distribution of six degrees of freedom: 1.22


def test_equal_machines_differ_by_chance_as_often_as_stated() -> None:
    rng = np.random.default_rng(16)
    chances = []
    for _ in range(500):
        errors = rng.uniform(0.2, 1.0, 5)
        chances.append(fit(rng.normal(2.0, errors), errors).chance or 0.0)
    assert 0.03 < np.mean(np.array(chances) < 0.05) < 0.08
    assert 0.45 < np.mean(np.array(chances) < 0.5) < 0.55


def test_equal_values_have_no_spread_and_an_interval_that_the_errors_set() -> None:
    own = fit([2.5] * 6, 0.1)
    assert (own.mean, own.spread, own.chance) == (2.5, 0.0, 1.0)
    assert own.standard_error == pytest.approx(0.1 / math.sqrt(6))
    assert own.interval == pytest.approx([0.0, 0.1 * math.sqrt(5 / chi2.ppf(0.025, 5) - 1.0)])


def test_of_fewer_than_three_machines_no_spread_is_stated() -> None:
    one = fit([2.0, 3.0, 2.5], [0.1, 0.1, 0.2], ["a"] * 3)
    assert (one.spread, one.interval, one.chance) == (None, None, None)
    assert (one.machines, one.recordings) == (1, 3)
    assert one.mean == pytest.approx(2.5)
    assert one.standard_error == pytest.approx(1.0 / 15.0)
    assert one.repeat_chance == pytest.approx(chi2.sf(50.0, 2))
    two = fit([2.0, 3.0], [0.1, 0.1])
    assert (two.spread, two.interval, two.chance) == (None, None, None)
    assert two.standard_error == pytest.approx(0.5)  # half of their difference, not their errors
    assert fit([2.0, 3.0, 4.0], 0.1).spread == pytest.approx(math.sqrt(1.0 - 0.1**2), rel=1e-5)


def test_a_recording_without_a_machine_is_a_machine() -> None:
    own = fit([2.0, 2.1, 1.9, 2.2], 0.1, [None, "", "a", "a"])
    assert (own.machines, own.recordings) == (3, 4)


def test_what_is_missing_is_left_out() -> None:
    rng = np.random.default_rng(2)
    rows: Rows = [
        {"machine": f"m{k}", "start": None, "v": v, "v.error": 0.1, "w": v, "w.error": 0.1}
        for k, v in enumerate(rng.normal(2.0, 0.3, 8))
    ]
    rows[1]["w"] = None
    rows[2]["w"] = math.nan
    rows[3]["w.error"] = 0.0
    del rows[4]["w"], rows[4]["w.error"]
    found = {own.name: own for own in shared(rows)}
    assert (found["v"].machines, found["w"].machines) == (8, 4)
    kept = [rows[k]["v"] for k in (0, 5, 6, 7)]
    assert found["w"].mean == fit(kept, 0.1).mean
    assert {own.name: own for own in shared(rows[::-1])}["v"].spread == pytest.approx(found["v"].spread)
    assert shared([{"machine": "a", "v": None, "v.error": None}]) == ()
    assert shared([]) == ()


def table(rng: np.random.Generator, *, repeats: int, error: float, noise: float, spread: float) -> Rows:
    """Return rows of ten machines as `batch` writes them, of a parameter with a prior of 2 ± 0.5."""
    rows: Rows = []
    for machine in range(10):
        own = 2.0 + rng.normal(0.0, spread) + rng.normal(0.0, math.sqrt(error**2 - noise**2))
        for data in own + rng.normal(0.0, noise, repeats):
            variance = 1.0 / (error**-2 + 0.5**-2)
            rows.append({
                "machine": f"m{machine}", "p": variance * (data / error**2 + 2.0 / 0.5**2),
                "p.error": math.sqrt(variance), "p.data": data, "p.data_error": error, "p.data_scatter": noise,
            })  # fmt: skip
    return rows


def without(rows: Rows, *columns: str) -> Rows:
    return [{name: value for name, value in row.items() if name not in columns} for row in rows]


def test_an_error_that_repeats_in_every_recording_of_a_machine_is_no_spread() -> None:
    rng = np.random.default_rng(3)
    chances, ignored = [], []
    for _ in range(50):
        rows = table(rng, repeats=20, error=0.5, noise=0.1, spread=0.0)
        chances.append(shared(rows)[0].chance or 0.0)
        ignored.append(shared([{**row, "p.data_scatter": 0.5} for row in rows])[0].chance or 0.0)
    assert sum(chance < 0.01 for chance in chances) <= 3
    assert sum(chance < 0.01 for chance in ignored) >= 45  # as if the errors were new in each


def test_the_prior_does_not_shrink_the_spread() -> None:
    rng = np.random.default_rng(5)
    found = []
    for _ in range(40):
        rows = table(rng, repeats=1, error=0.4, noise=0.4, spread=1.0)
        bare = shared(without(rows, "p.data", "p.data_error", "p.data_scatter"))
        found.append([(own[0].spread or 0.0) ** 2 for own in (shared(rows), bare)])
    data, posterior = np.sqrt(np.mean(found, axis=0))
    assert data == pytest.approx(1.0, abs=0.15)
    assert posterior < 0.7
    # a recording that determines no more than its prior has no columns of the data, and does not count
    rows[0] = without(rows[:1], "p.data", "p.data_error", "p.data_scatter")[0]
    assert shared(rows)[0].machines == 9


def linear(inverse: NDArray[np.float64], design: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return problem and fit of a linear model with unit noise and priors about zero of these inverse deviations."""
    covariance = np.linalg.inv(design.T @ design + np.diag(inverse**2))
    return SimpleNamespace(unknowns=SimpleNamespace(prior=lambda _: (inverse, []))), SimpleNamespace(
        terms=(), columns=[], covariance=covariance, coefficients={}, nuisance=np.zeros(len(inverse))
    )


def test_the_scatter_of_an_estimate_is_that_of_repeated_recordings_of_one_machine() -> None:
    """Also of a sum of estimates."""
    rng = np.random.default_rng(9)
    inverse, design = np.array([1.0, 2.0, 0.0]), rng.normal(size=(6, 3))
    problem, found = linear(inverse, design)
    truth = np.array([1.5, -0.8, 3.0])
    rows = design @ truth + rng.normal(size=(20000, 6))
    estimates = rows @ design @ found.covariance
    for along in (*np.eye(3), np.array([0.4, 0.0, 1.0])):
        assert scatter(problem, found, along) == pytest.approx((estimates @ along).std(), rel=0.02)
        assert scatter(problem, found, along) < math.sqrt(along @ found.covariance @ along)


def test_a_bench_parameter_has_its_estimate_without_prior() -> None:
    """Also its scatter, again that of repeated recordings."""
    rng = np.random.default_rng(10)
    stated = SimpleNamespace(name="coil_constant", value=0.02, uncertainty=4e-4, unit="N*m/V")
    design = rng.normal(size=(5, 2)) * [3.0, 1.0]
    problem, found = linear(np.ones(2), design)
    problem.unknowns.nuisances = [("coil_constant", [stated])]
    values = []
    for row in design @ [0.7, -1.1] + rng.normal(size=(5000, 5)):
        found.nuisance = found.covariance @ design.T @ row
        problem.unknowns.values = lambda fit: {"coil_constant": 0.02 + 4e-4 * fit.nuisance[0]}
        own = nuisance_estimates(problem, found)["coil_constant"]
        assert own.data is not None
        values.append(own.data[0])
    assert own.data == without_prior(own.value, own.standard_error, Prior(0.02, 4e-4))
    assert own.scatter == pytest.approx(np.std(values), rel=0.04)


LATE = own_effect("late: tilt_delay = 0.001*a")


@pytest.mark.parametrize(
    ("name", "parameter", "change"),
    [
        ("coil_gain_error", "coil_constant", 0.02),  # its deviation is held
        ("stiffness_error", "flexure_stiffness_x", 0.1343),  # its deviation from the common factor is not
        ("encoder_once", "encoder_once_y", 1.0),
        ("late", "tilt_delay", 0.001),
    ],
)
@pytest.mark.parametrize("repeated", [False, True])
def test_a_parameter_that_was_found_has_value_error_and_scatter_of_the_finding(
    name: str, parameter: str, change: float, repeated: bool
) -> None:
    """Of many machines, the values are off by the error; of one they scatter by the scatter."""
    rng = np.random.default_rng(11)
    unknowns = Unknowns(BENCH, declared={"late": LATE})
    term, stated = unknowns.term(name), BENCH.parameters[parameter]
    inverse, columns = unknowns.prior([term])
    size = 3.0 * stated.uncertainty / change  # of the coefficients
    design = rng.normal(size=(2 * len(inverse), len(inverse)))
    design[:, unknowns.count :] /= size
    covariance = np.linalg.inv(design.T @ design + np.diag(inverse**2))
    place = next(k for k, (_, own) in enumerate(unknowns.nuisances) if stated in own)

    def machine() -> NDArray[np.float64]:
        return np.concatenate(
            [rng.normal(size=unknowns.count) * (inverse[: unknowns.count] == 1.0), [size] * len(columns)]
        )

    truth, off = machine(), []
    for _ in range(500):
        truth = truth if repeated else machine()
        x = covariance @ design.T @ (design @ truth + rng.normal(size=len(design)))
        found: Any = SimpleNamespace(
            terms=(term,), columns=columns, covariance=covariance, nuisance=x[: unknowns.count],
            coefficients={name: {key: v for (_, key), v in zip(columns, x[unknowns.count :], strict=True)}},
        )  # fmt: skip
        problem: Any = SimpleNamespace(unknowns=unknowns)
        own = nuisance_estimates(problem, found)[parameter]
        off.append(own.value - stated.value - stated.uncertainty * truth[place] - change * size)
        assert own.data == (own.value, own.standard_error)
    assert own.scatter is not None
    assert np.std(off) == pytest.approx(own.scatter if repeated else own.standard_error, rel=0.1)
    assert own.scatter < own.standard_error
