"""Estimation of chosen parameters: against iminuit and SciPy on the same rows, and what it states of priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from iminuit import Minuit
from numpy.typing import NDArray
from scipy.optimize import curve_fit

import gyrowheel as gw
from gyrowheel.models.estimation import Fit
from gyrowheel_core.arrays import one_thread

from ..letters import check_letters

Array = NDArray[np.float64]

CONTOUR = 5.991465  # quantile of chi-squared, 95 %, two parameters


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> gw.Recording:
    path = tmp_path_factory.mktemp("estimation") / "quick"
    gw.simulate("quick", effects={"windage": {"w": 0.0013}}, machine=6).save(path)
    return gw.Recording.open(path)


@pytest.fixture(scope="module")
def model(recording: gw.Recording) -> gw.Model:
    return gw.Model().add("windage", fit=recording)


@pytest.fixture(scope="module")
def fit(model: gw.Model, recording: gw.Recording) -> Fit[gw.Model]:
    return model.fit(recording, free=["windage", "bearing_viscous"])


def slope(fit: Fit[gw.Model], x: Sequence[float] | Array) -> Array:
    """Return the derivatives of the cost by the parameters in standard errors, from those of the residuals."""
    size, at = np.array(list(fit.errors.values())), np.asarray(x)
    residuals = lambda y: fit.cost.residuals(y * size)  # noqa: E731
    return 2.0 * differences(residuals, at) @ residuals(at)


def curvature(fit: Fit[gw.Model], x: Sequence[float]) -> Array:
    """Return the second derivatives of the cost by the parameters in standard errors."""
    found = differences(lambda y: slope(fit, y), np.asarray(x))
    return 0.5 * (found + found.T)


def differences(function: Callable[[Array], Array], at: Array) -> Array:
    """Return the derivatives of a function (parameters, ...) by differences of fourth order."""
    rows = []
    for step in 0.2 * np.eye(len(at)):
        near = function(at + step) - function(at - step)
        far = function(at + 2.0 * step) - function(at - 2.0 * step)
        rows.append((8.0 * near - far) / (12.0 * step.max()))
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize("profiles", [False, pytest.param(True, marks=pytest.mark.study)])
def test_estimates_and_intervals_are_those_of_iminuit(fit: Fit[gw.Model], profiles: bool) -> None:
    cost, size = fit.cost, np.array(list(fit.errors.values()))

    def scaled(x: Sequence[float]) -> float:
        return cost(np.asarray(x) * size)

    # HESSE's own differences are good to 1e-3: it gets derivatives of the rows by differences of fourth order
    minuit = Minuit(
        scaled,
        fit.values / size + 0.1,
        name=fit.names,
        grad=lambda x: slope(fit, x),
        hessian=lambda x: curvature(fit, x),
    )
    minuit.errordef, minuit.strategy, minuit.tol = Minuit.LEAST_SQUARES, 2, 1e-9
    minuit.migrad()
    minuit.hesse()
    assert minuit.valid
    if profiles:
        minuit.minos(cl=0.95)
        for k, (name, ends) in enumerate(fit.conf_interval(*fit.names).items()):
            errors = minuit.merrors[name]
            assert np.array(ends) / size[k] == pytest.approx(
                fit.values[k] / size[k] + [errors.lower, errors.upper], abs=1e-3
            )
        # the profile of each, and the border of a region, in chi-squared
        for k, name in enumerate(fit.names):
            at = fit.values[k] / size[k] + np.array([-2.0, 1.0])
            _, least, _ = minuit.mnprofile(name, bound=tuple(at), size=2)
            assert least - minuit.fval == pytest.approx(fit.along(name, at * size[k]), abs=1e-6)
        for pair in zip(*fit.contour(fit.names[0], fit.names[1], points=2), strict=True):
            held = Minuit(scaled, np.asarray(minuit.values), name=fit.names)
            held.errordef, held.strategy, held.tol = Minuit.LEAST_SQUARES, 2, 1e-9
            for name, value, unit in zip(fit.names, pair, size, strict=False):
                held.values[name], held.fixed[name] = value / unit, True
            assert held.migrad().fval - minuit.fval == pytest.approx(CONTOUR, abs=1e-6)
    # in standard errors
    assert np.asarray(minuit.values) == pytest.approx(fit.values / size, abs=1e-4)
    assert minuit.fval == pytest.approx(fit.chi2, abs=1e-6)
    assert np.asarray(minuit.covariance) == pytest.approx(
        fit.covariance.values / np.outer(size, size), abs=1e-6
    )


def test_covariance_does_not_depend_on_the_step_of_its_differences(fit: Fit[gw.Model]) -> None:
    size = np.array(list(fit.errors.values()))
    with one_thread():
        other = np.linalg.inv(fit.cost.hessian(fit.values, 0.05 * size) * np.outer(size, size))
    assert other == pytest.approx(fit.covariance.values / np.outer(size, size), abs=1e-5)


@pytest.mark.slow
def test_profile_and_contour_lie_where_chi_squared_rises_by_the_quantile(fit: Fit[gw.Model]) -> None:
    low, high = fit.interval("windage.n")
    assert fit.along("windage.n", [low, high]) == pytest.approx([3.8415, 3.8415], abs=1e-3)
    x, y = fit.contour("windage.w", "windage.n", points=4)
    cost = fit.cost
    with one_thread():
        for pair in zip(x, y, strict=True):
            held = dict(zip((0, 1), pair, strict=True))
            steps = 0.1 * np.array(list(fit.errors.values()))
            assert cost.minimum(fit.values, steps, held).cost - fit.chi2 == pytest.approx(5.9915, abs=1e-3)


@pytest.mark.slow
def test_linear_problem_has_the_covariance_of_scipy(model: gw.Model, recording: gw.Recording) -> None:
    fit = model.fit(recording, free="windage.w")
    cost, count = fit.cost, fit.rows
    found, covariance = curve_fit(
        lambda _, w: -cost.white(np.array([w])), np.arange(count), np.zeros(count), [1.1 * fit.values[0]],
        absolute_sigma=True, xtol=1e-12, ftol=1e-12,
    )  # fmt: skip
    # in standard errors, as above
    assert found[0] == pytest.approx(fit.values[0], abs=1e-4 * fit.errors["windage.w"])
    assert covariance[0, 0] == pytest.approx(fit.covariance["windage.w", "windage.w"], rel=1e-5)


@pytest.mark.slow
def test_prior_data_and_both_are_stated_and_agree(fit: Fit[gw.Model]) -> None:
    exponent = fit.params["windage.n"]
    assert exponent.prior is not None
    assert exponent.data is not None
    (mean, deviation), (value, error) = exponent.prior, exponent.data
    weights = np.array([deviation, error]) ** -2.0
    assert exponent.value == pytest.approx(np.average([mean, value], weights=weights))
    assert exponent.standard_error == pytest.approx(weights.sum() ** -0.5)
    assert fit.params["windage.w"].prior is None
    page = str(fit)
    assert "1.480 ± 0.030" in page
    assert "from the data alone" in page
    free = fit.model.fit(fit.recordings, free=["windage", "bearing_viscous"], priors={"windage.n": None})
    # the posterior is nearly normal
    assert free.params["windage.n"].value == pytest.approx(value, abs=0.1 * error)
    assert free.errors["windage.n"] == pytest.approx(error, rel=0.15)


@pytest.mark.slow
def test_fixed_and_bounded_parameters_stay_where_they_are_put(
    model: gw.Model, recording: gw.Recording
) -> None:
    held = model.fit(recording, free="windage.*", fixed="windage.n")
    assert held.names == ["windage.w"]
    assert held.params["windage.n"].value == model.effects["windage"]["n"]
    limited = model.fit(recording, free="windage", bounds={"windage.n": (0.5, 1.3)})
    assert limited.params["windage.n"].value == 1.3
    assert limited.params["windage.n"].at_bound
    assert "lies at a bound" in str(limited)


def test_fit_makes_a_model_with_one_more_entry_that_can_be_undone(
    fit: Fit[gw.Model], model: gw.Model
) -> None:
    assert fit.model.effects["windage"]["w"] == fit.params["windage.w"].value
    assert fit.model.effect_errors["windage"]["n"] == fit.errors["windage.n"]
    assert fit.model.parameters["bearing_viscous"].value == fit.params["bearing_viscous"].value
    assert fit.model.history[-1]["what"] == "fit windage.w, windage.n, bearing_viscous"
    assert fit.model.undo().effects == model.effects


def test_rows_give_chi_squared_and_leverage_the_number_of_parameters(fit: Fit[gw.Model]) -> None:
    frame = fit.residuals()
    assert (frame["whitened"] ** 2).sum() == pytest.approx(fit.chi2_rows)
    assert np.allclose(frame["measured"] - frame["predicted"], frame["residual"])
    for name, (chi2, count) in fit.channels.items():
        own = frame[frame["channel"] == name]
        assert (own["whitened"] ** 2).sum() == pytest.approx(chi2)
        assert len(own) == count
    # what the prior of the exponent determines is not from the rows
    exponent = fit.params["windage.n"]
    viscous = fit.params["bearing_viscous"]
    assert exponent.prior is not None
    assert viscous.prior is not None
    from_priors = sum((p.standard_error / p.prior.deviation) ** 2 for p in (exponent, viscous) if p.prior)
    assert frame["leverage"].sum() == pytest.approx(3.0 - from_priors, rel=0.03)


@pytest.mark.slow
def test_criteria_prefer_the_model_with_the_effect(model: gw.Model, recording: gw.Recording) -> None:
    fit = model.fit(recording, free=["windage.w", "bearing_viscous"])
    with pytest.raises(gw.InputError, match=r"evidence: the two fits have different rows or noise"):
        gw.Model().fit(recording, free="bearing_viscous").evidence(fit)
    wide = model.fit(recording, free=["windage.w", "bearing_viscous"], bounds={"windage.w": (-0.05, 0.05)})
    assert fit.evidence(wide) == pytest.approx(0.0, abs=1e-6)
    assert fit.aic == pytest.approx(fit.chi2 - fit.chi2_rows - 2.0 * fit.log_likelihood + 4.0)


def test_draws_have_the_covariance_and_a_seed(fit: Fit[gw.Model]) -> None:
    drawn = fit.sample(4000, seed=1)
    found = np.cov(np.array(list(drawn.values())))
    size = np.array(list(fit.errors.values()))
    assert found / np.outer(size, size) == pytest.approx(
        fit.covariance.values / np.outer(size, size), abs=0.1
    )
    assert np.array_equal(drawn["windage.w"], fit.sample(4000, seed=1)["windage.w"])


def test_residuals_of_a_complete_model_are_white(fit: Fit[gw.Model]) -> None:
    lag, correlation, band = fit.correlations("spin", "spin", lags=10)
    assert correlation[lag == 0] == pytest.approx(1.0)
    assert np.mean(np.abs(correlation[lag > 0]) < band) >= 0.8
    assert np.abs(fit.correlations("tilt_x", "tilt_y", lags=5)[1]).max() < 3.0 * band


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"free": "windge"}, r"free: windge: no such parameter; did you mean windage\.w\?"),
        ({"free": "windage.w", "fixed": "windage"}, r"free: no parameter is left to estimate"),
        (
            {"bounds": {"windage.w": (1.0, 0.0)}},
            r"bounds\.windage\.w: .* is not allowed; allowed: \(lowest, highest\)",
        ),
        (
            {"priors": {"windage.n": (1.0, 0.0)}},
            r"priors\.windage\.n: .* allowed: \(mean, standard deviation > 0\)",
        ),
        ({"priors": {"n": None}}, r"n: no such parameter"),
        ({"loss": "lp"}, r"loss: 'lp' is not allowed; allowed: linear, soft_l1, huber, cauchy"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    model: gw.Model, recording: gw.Recording, options: dict[str, object], message: str
) -> None:
    with pytest.raises(gw.InputError, match=message) as caught:
        model.fit(recording, **options)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_pictures_of_a_fit_have_their_names_and_units(fit: Fit[gw.Model]) -> None:
    assert fit.plot().axes[0].get_title("left") == "Correlation of the estimates"
    check_letters(fit.plot())
    assert fit.plot("windage.w").axes[0].get_xlabel() == "windage.w, mN·m"
    with pytest.raises(gw.InputError, match=r"motor_constant: is fixed; allowed: windage\.w"):
        fit.plot("motor_constant")
