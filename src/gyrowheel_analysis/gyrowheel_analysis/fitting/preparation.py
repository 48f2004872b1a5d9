"""From recordings and a model to a fit problem."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.balance.balance import Balance
from gyrowheel_analysis.balance.history import History
from gyrowheel_analysis.channels import unphased
from gyrowheel_analysis.criteria import FEWEST_WINDOWS, MAP_MARGIN, MAP_WARMER, OTHER_MACHINE
from gyrowheel_analysis.fitting.fit import Fit, Unknowns
from gyrowheel_analysis.fitting.kept_windows import reduced
from gyrowheel_analysis.fitting.problem import Problem
from gyrowheel_analysis.model import Model
from gyrowheel_analysis.reduction.instrument_readings import ReadingFindings, Shown, reading_findings
from gyrowheel_analysis.reduction.quality import NEEDED
from gyrowheel_analysis.reduction.samples import Commanded, Samples
from gyrowheel_analysis.reduction.windows import Coverage, Windows
from gyrowheel_core.arrays import by_blocks
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.reader import require_rate
from gyrowheel_recording.derived import assumed_errors, lacking, largest_errors, shares, unmeasured
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.torque_map import TorqueMap

Progress = Callable[[str], None]
Array = NDArray[np.float64]

_ANSWER = 2  # samples from the one that a command answers to the first whose voltages show it
#: Parameters by which machines are distinguished, by a factor of `OTHER_MACHINE`. Stated uncertainties would not do: a
#: better value for the same machine often lies tens of them from the first one, while nobody mistakes an inertia, a
#: flexure or the sample period by a factor of two.
_DISTINGUISHING = (
    "rotor_inertia_x",
    "rotor_inertia_z",
    "flexure_stiffness_x",
    "flexure_stiffness_y",
    "sample_period",
)
#: Parameter of the bench that is the error of an angle from pulses, the same in all windows.
_PHASE = "encoder_zero"


def too_few_windows(windows: int, coverage: Coverage) -> str:
    """Return a sentence with the number of windows, the number needed, and the coverage."""
    taken = coverage.sentence()
    return (
        f"{windows} steady windows; at least {FEWEST_WINDOWS} are needed: record more holds, as the plan quick "
        f"has them; {taken[0].lower()}{taken[1:]}"
    )


class TooFewWindowsError(InputError):
    """Recordings have too little steady motion for the analysis.

    Attributes
    ----------
    windows : int
        Number of windows.
    coverage : Coverage
        Use of the recordings.
    """

    def __init__(self, names: Sequence[str], windows: int, coverage: Coverage) -> None:
        self.windows, self.coverage = windows, coverage
        super().__init__(f"{', '.join(names)}: {too_few_windows(windows, coverage)}")


@dataclass(frozen=True)
class Prepared:
    """Recordings with their fit problem, and with those for validation.

    `problem` has the magnitudes of the drifts estimated from the recordings; `names` are these in order, `windows` is
    the number of their windows, `coverage` their use, and `shown` the instruments of each as its samples show them.
    `weighed_by` is the fit whose machine noise and rows are of, None for those of the bench as stated.
    `validation` has recordings that take no part in fit and drift estimate; None if none of them has a window.
    """

    problem: Problem
    names: list[str]
    windows: int
    coverage: Coverage
    validation: Prepared | None = None
    shown: list[Shown] = field(default_factory=list)
    weighed_by: Fit | None = None

    def readings(self, bench: Bench) -> ReadingFindings:
        """Return the deviations of the instruments from a bench that the samples of all recordings show."""
        other = self.validation
        shown = [*self.shown, *(other.shown if other else [])]
        return reading_findings(shown, [*self.names, *(other.names if other else [])], bench)

    def reweighed(self, fit: Fit) -> Prepared:
        """Return the same with the noise of the machine that a fit describes; itself where that hardly differs."""
        problem = self.problem.reweighed(fit)
        return self if problem is self.problem else replace(self, problem=problem, weighed_by=fit)


def samples_of(recording: Recording, *, incomplete: bool = False) -> Samples:
    """Return the columns of a recording that the reduction needs; `incomplete` allows for derived readings.

    Raises
    ------
    InputError
        If a reading that cannot be derived from others was never measured, or the samples are too far apart.
    """
    require_rate(recording)
    absent = unmeasured(recording.readings)
    if incomplete:
        if needed := lacking(recording.readings):
            raise InputError(
                f"{recording.path}: {', '.join(needed)}: no reading is a number; allowed: readings of both tilts, of "
                "the angle or the speed, and of at least one voltage or current"
            )
    elif missing := [name for name in NEEDED if not np.isfinite(recording.readings[name]).any()]:
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
        part=recording.part,
        sequence=recording.measurement["sequence"],
        commanded=_commanded(recording),
        absent=absent,
        origins=recording.origins,
    )


def _commanded(recording: Recording) -> Commanded | None:
    """Return the coil voltages that were commanded; None if unknown.

    A command that answers sample k acts from sample k + 1 to sample k + 2.
    """
    commands, samples = recording.given_commands, recording.measurement["sequence"]
    if not len(commands) or len(commands) < len(samples) // 2:
        return None
    # counted from the first sample: their numbers may be too large for a signed integer, and wrap
    answered = (commands["measurement_sequence"] - samples[0]).astype(np.int64)
    if np.any(answered[1:] < answered[:-1]):
        return None
    places = np.empty(len(samples), np.int32)  # enough for twelve days

    def find(first: int, last: int) -> None:
        shown = (samples[first:last] - samples[0]).astype(np.int64) - _ANSWER
        places[first:last] = np.maximum(np.searchsorted(answered, shown, side="right") - 1, 0)

    by_blocks(len(samples), find)
    return Commanded((commands["coil_voltage_x"], commands["coil_voltage_y"]), places)


def prepare(
    recordings: Sequence[Recording],
    model: Model,
    *,
    validate: Sequence[Recording] = (),
    harmonics: bool = True,
    drift_scales: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Prepared:
    """Reduce recordings, put them together with a model, and estimate their drifts.

    Parameters
    ----------
    recordings, validate : sequence of Recording
        Recordings of one machine; nothing is fitted to those of `validate`.
    model : Model
        The model.
    harmonics : bool
        Whether to use harmonics within a revolution, or averages alone.
    drift_scales : dict of str to float, optional
        Known magnitudes of the drifts over the stated ones; estimated by default.
    progress : callable, optional
        Called with a line of text for each step.

    Raises
    ------
    TooFewWindowsError
        If the recordings have too little steady motion.
    InputError
        If there is no recording, one is of another bench (`require_one_bench`), or its readings are impossible on this
        one.
    """
    if not recordings:
        raise InputError("no recording given")
    errors = largest_errors([_assumed(own) for own in (*recordings, *validate)])
    balances, coverage, shown = _reduced(recordings, model, harmonics, errors, progress)
    names, count = [r.name for r in recordings], sum(len(b.windows) for b in balances)
    if count < FEWEST_WINDOWS:
        raise TooFewWindowsError(names, count, coverage)
    validation = None
    others: list[Balance] = []
    if validate:
        others, other_coverage, other_shown = _reduced(validate, model, harmonics, errors, progress, shown)
    phase = max((b.phase_error for b in (*balances, *others)), default=0.0)
    unknowns = Unknowns(
        model.reference_bench,
        model.effects,
        model.effect_errors,
        model.declared,
        errors | ({_PHASE: phase} if phase else {}),
    )
    if windows := sum(len(b.windows) for b in others):
        validation = Prepared(
            Problem.of(others, unknowns),
            [r.name for r in validate],
            windows,
            other_coverage,
            shown=other_shown,
        )
    problem = Problem.of(balances, unknowns)
    if drift_scales is None:
        if progress:
            progress("estimating noise and drift")
        problem = problem.with_drift_estimated()
    else:
        problem = problem.with_scales(drift_scales)
    return Prepared(problem, names, count, coverage, validation, shown)


def _reduced(
    recordings: Sequence[Recording],
    model: Model,
    harmonics: bool,
    errors: Mapping[str, float],
    progress: Progress | None,
    elsewhere: Sequence[Shown] = (),
) -> tuple[list[Balance], Coverage, list[Shown]]:
    """Return the balance of every recording, the coverage of them all, and the instruments as their samples show them.

    The noise of each includes hum that any of them shows, or others `elsewhere`. `errors` are the result of
    `largest_errors` for all recordings of the fit.
    """
    require_one_bench(recordings, model)
    bench = model.reference_bench
    every_windows, coverages, shown, absent, every_samples = [], [], [], [], []
    for recording in recordings:
        if progress:
            progress(f"reducing {recording.name}")
        samples = samples_of(recording, incomplete=True)
        absent.append(samples.absent | _unphased(recording, bench))
        own = reduced(recording, samples, bench)
        _check(own.windows, bench, str(recording.path))
        _check_maps(own.windows, model, str(recording.path))
        coverages.append(own.coverage)
        shown.append(own.shown)
        every_windows.append(own.windows)
        every_samples.append(samples)
    every = [*shown, *elsewhere]
    balances = [
        Balance(
            looked.weighed(windows, every),
            bench,
            harmonics=harmonics,
            absent=lacks,
            assumed=shares(_assumed(recording), errors),
            phase_error=_phase_error(recording),
            history=History(windows, bench, samples),
        )
        for recording, looked, windows, lacks, samples in zip(
            recordings, shown, every_windows, absent, every_samples, strict=True
        )
    ]
    return balances, Coverage.of(coverages), shown


def _assumed(recording: Recording) -> dict[str, float]:
    """Return the uncertainty of assumed readings of a recording [SI, 1 sigma], by reading."""
    stated = {name: own.uncertainty for name, own in recording.origins.items() if not own.pulses}
    return assumed_errors(recording.readings, stated)


def _phase_error(recording: Recording) -> float:
    """Return the uncertainty of an angle from pulses [rad, 1 sigma]; 0 for one that was read."""
    origin = recording.origins.get("spin_angle")
    return origin.uncertainty if origin is not None and origin.pulses else 0.0


def _unphased(recording: Recording, bench: Bench) -> frozenset[str]:
    """Return the quantities that an angle from pulses does not show (`channels.unphased`)."""
    origin = recording.origins.get("spin_angle")
    if origin is None or not origin.pulses:
        return frozenset()
    return unphased(origin.pulses, bench.value("motor_ripple_order"))


def require_one_bench(recordings: Sequence[Recording], model: Model) -> None:
    """Refuse recordings of another bench than that of the model, or of different benches.

    Two benches are different if their names differ and one of the distinguishing parameters is more than twice that of
    the other. So a bench file under another name for the same machine passes, and so does a machine that differs from
    its bench: that is a matter of the diagnosis. A recording that does not name its bench is not checked.

    Raises
    ------
    InputError
        For two different benches; it names the recording, the parameter and both benches.
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
            for key in _DISTINGUISHING:
                own, its = values.get(key, math.nan), its_values.get(key, math.nan)
                # false for NaN
                if max(own, its) > OTHER_MACHINE * min(own, its) > 0.0:
                    raise InputError(
                        f"{recording.path}: is of bench {name}, {other} of bench {its_name}: {key} is {own:.4g} and "
                        f"{its:.4g} {stated.parameters[key].unit}; allowed: the same machine"
                    )
        known.append((str(recording.path), name, values))


def _check_maps(windows: Windows, model: Model, where: str) -> None:
    """Refuse a recording outside of the range of a map of the model: nobody knows the torque there."""
    for name in model.effects:
        effect = model.declared.get(name)
        if not isinstance(effect, TorqueMap) or not len(windows):
            continue
        within, tilt = effect.within, float(np.abs(windows.mean_tilt).max())
        slowest, fastest = float(windows.mean_spin.min()), float(windows.mean_spin.max())
        warm = any(term.temperature for term in effect.terms if term.target == "rotor_torque")
        coldest, hottest = float(windows.coil_temperature.min()), float(windows.coil_temperature.max())
        low, high = within.speed
        if slowest < low * (1.0 - MAP_MARGIN) or fastest > high * (1.0 + MAP_MARGIN):
            outside = f"speeds are {slowest / RPM:.0f} .. {fastest / RPM:.0f} rpm"
            allowed = f"{low / RPM:.0f} .. {high / RPM:.0f} rpm"
        elif tilt > within.tilt * (1.0 + MAP_MARGIN):
            outside, allowed = f"tilts are up to {tilt / DEG:.2f} deg", f"up to {within.tilt / DEG:.2f} deg"
        elif warm and (coldest < within.coils[0] - MAP_WARMER or hottest > within.coils[1] + MAP_WARMER):
            outside = f"temperatures of the coils are {coldest:.1f} .. {hottest:.1f} K"
            allowed = f"{within.coils[0]:.1f} .. {within.coils[1]:.1f} K"
        else:
            continue
        raise InputError(
            f"{where}: {outside}, outside of the range of '{name}' in {model.origin}; allowed: {allowed}. Remove the "
            "map (gyrowheel model remove) and make it again from recordings that have this range"
        )


def _check(windows: Windows, bench: Bench, where: str) -> None:
    """Refuse readings that are impossible on this bench; the usual cause is wrong units."""
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
