"""From recordings and a model to a problem that can be fitted."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.fitting.problem import Fit, Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.recording import Recording
from gyrowheel_analysis.reduction import NEEDED, Coverage, Samples, Windows, reduce_and_account
from gyrowheel_analysis.residuals.error_table import (
    ErrorRow,
    ErrorTable,
    Residuals,
    error_row,
    floor_row,
    residuals,
)
from gyrowheel_core.errors import InputError
from gyrowheel_sim.bench import Bench

Progress = Callable[[str], None]

#: Fewer windows than this show nothing.
FEWEST_WINDOWS = 6
#: Parameters that tell one machine from another, and by which factor they must lie apart for that. Stated uncertainties
#: would not do: a better figure for the same machine often lies tens of them from the first one, while a factor of
#: two in an inertia, a flexure or the sample period is no matter of knowing it better.
_TELLING = (
    "rotor_inertia_x",
    "rotor_inertia_z",
    "flexure_stiffness_x",
    "flexure_stiffness_y",
    "sample_period",
)
_APART = 2.0


@dataclass(frozen=True)
class Prepared:
    """Recordings made ready.

    Attributes
    ----------
    problem : Problem
        What can be fitted.
    names : list of str
        The recordings in it, in order.
    windows : int
        How many windows they have.
    coverage : Coverage
        How much of them lies in these windows.
    """

    problem: Problem
    names: list[str]
    windows: int
    coverage: Coverage


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Keep linear algebra on one thread: its matrices are small, and threads would only wait for one another."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


def samples_of(recording: Recording) -> Samples:
    """Return the columns of a recording that the reduction needs.

    Raises
    ------
    InputError
        If one that nothing can stand for was never measured.
    """
    if missing := [name for name in NEEDED if not np.isfinite(recording.readings[name]).any()]:
        raise InputError(
            f"{recording.path}: {', '.join(missing)}: no reading is a number; "
            f"allowed: readings of {', '.join(NEEDED)} in most samples, all else may be missing"
        )
    return Samples(
        time=recording.time,
        readings=recording.readings,
        setpoint_time=recording.seconds(recording.setpoint["stamp_ns"]),
        setpoint=recording.setpoint,
        environment=recording.environment,
    )


def prepare(
    recordings: Sequence[Recording],
    model: Model,
    *,
    harmonics: bool = True,
    progress: Progress | None = None,
) -> Prepared:
    """Reduce recordings and put them together with a model; `harmonics` as in `Balance`.

    Raises
    ------
    InputError
        If there is no recording, one is of another bench (`require_one_bench`), or its readings cannot be those of this
        one.
    """
    if not recordings:
        raise InputError("no recording given")
    require_one_bench(recordings, model)
    bench = model.reference_bench
    balances, coverages = [], []
    for recording in recordings:
        if progress:
            progress(f"reducing {recording.name}")
        windows, coverage = reduce_and_account(samples_of(recording), bench)
        _check(windows, bench, str(recording.path))
        coverages.append(coverage)
        balances.append(Balance(windows, bench, harmonics=harmonics))
    problem = Problem(balances, bench, model.effects, model.effect_errors, model.declared)
    count = sum(len(b.windows) for b in balances)
    return Prepared(problem, [r.name for r in recordings], count, Coverage.of(coverages))


def require_one_bench(recordings: Sequence[Recording], model: Model) -> None:
    """Refuse recordings that are plainly of another bench than the model, or than one another.

    Benches are taken to be different if both their names and their machines are: one of some telling parameters is more
    than twice that of the other. A bench file of one's own under another name for the same machine passes, and so does
    a machine that differs from its bench, which it is the model's business to find. A recording that does not say of
    which bench it is goes unchecked.

    Raises
    ------
    InputError
        If there are two different benches; it names the recording, the parameter and both benches.
    """
    stated = model.stated_bench
    known: list[tuple[str, str, Mapping[str, float]]] = [(model.origin, stated.name, stated.values())]
    for recording in recordings:
        if (carried := recording.carried_bench) is None:
            continue
        name, values = carried
        for other, its_name, its_values in known:
            if name == its_name:
                continue
            for key in _TELLING:
                own, its = values.get(key, math.nan), its_values.get(key, math.nan)
                # false for what is not a number
                if max(own, its) > _APART * min(own, its) > 0.0:
                    raise InputError(
                        f"{recording.path}: is of bench {name}, {other} of bench {its_name}: {key} is {own:.4g} and "
                        f"{its:.4g} {stated.parameters[key].unit}; allowed: the same machine"
                    )
        known.append((str(recording.path), name, values))


def _check(windows: Windows, bench: Bench, where: str) -> None:
    """Refuse readings that no test on this bench can give: wrong units are the usual cause."""
    if not len(windows):
        return
    tilt = float(np.abs(windows.mean_tilt).max())
    if tilt > 3.0 * bench.value("tilt_limit"):
        raise InputError(
            f"{where}: tilt_x, tilt_y: {tilt:.3g} rad is out of range; "
            f"allowed: up to {3 * bench.value('tilt_limit'):.3g} rad"
        )
    speed = float(windows.mean_spin.max())
    if speed > 2.0 * bench.value("spin_rate_maximum"):
        raise InputError(
            f"{where}: spin_rate: {speed:.4g} rad/s is out of range; "
            f"allowed: up to {2 * bench.value('spin_rate_maximum'):.4g} rad/s"
        )


@dataclass(frozen=True)
class Errors:
    """The error table of two fits, and the residuals behind it."""

    table: ErrorTable
    residuals: list[Residuals]


def errors_of(before: Fit, after: Fit, fitted: Prepared, validation: Prepared | None) -> Errors:
    """Return how the error falls from one fit to another, on the fitted and on unused recordings.

    On the unused recordings nothing is fitted: parameters and coefficients are those of the fits.
    """
    problem = fitted.problem
    white, deviation = problem.noise.whiten, problem.noise.deviation()
    rows = residuals(problem.balances, fitted.names, "fit", before.residual, after.residual, deviation)
    parts: list[ErrorRow | None] = [None, None, None]
    if validation is not None and validation.windows:
        other = validation.problem
        other.noise.use_scales(problem.noise.scales)
        for term in after.terms:
            if term.effect is not None:
                other.library[term.name] = term.effect
        left = [other.measured - other.predict(fit.nuisance, fit.coefficients) for fit in (before, after)]
        floor = other.noise.deviation()
        parts = [error_row(other.balances, r, other.noise.whiten(r)) for r in left]
        parts.append(floor_row(other.balances, floor))
        rows += residuals(other.balances, validation.names, "validation", left[0], left[1], floor)
    table = ErrorTable(
        before=error_row(problem.balances, before.residual, white(before.residual)),
        after=error_row(problem.balances, after.residual, white(after.residual)),
        noise_floor=floor_row(problem.balances, deviation),
        validation_before=parts[0],
        validation_after=parts[1],
        validation_noise_floor=parts[2],
    )
    return Errors(table, rows)
