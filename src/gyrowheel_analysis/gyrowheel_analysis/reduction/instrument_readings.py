"""The instruments as the samples show them: hum, steps of the converters, the clock; and deviations from the bench.

They cause no torque, so they are no effects and do not change the verdict. They make the rows of the balance noisier.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gyrowheel_analysis.criteria import (
    BURST_OUTLIERS,
    CLEAR_HIDDEN_JITTER,
    CLEAR_READING,
    CLOCK_RATE,
    HIDDEN_PART,
    HUM_PART,
    JITTER_PART,
    MAINS_FREQUENCY,
    RATE_AGREES,
    SAME_STEP,
    STEP_PART,
)
from gyrowheel_analysis.reduction.clock import Stamps, read_stamps
from gyrowheel_analysis.reduction.hum import Line, find_lines, hum_variance, unobservable
from gyrowheel_analysis.reduction.outliers import Outliers, outliers
from gyrowheel_analysis.reduction.quality import READING_NOISES, readable
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import steady_spans
from gyrowheel_analysis.reduction.windows import Windows
from gyrowheel_core.readings import READINGS, Readings
from gyrowheel_recording.derived import ASSUMED
from gyrowheel_recording.mislabelled.held import held_readings
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_PIECES, _LENGTH = 4, 2000  # examined pieces of the recording, and samples in each
_ROUNDING = 32.0  # of the last digit of the largest value: smaller changes count as zero
_NEAR = 0.02  # of a step: largest distance of a change from a whole number of steps
_MOST_OFF = 0.01  # of the changes
_TRIES = 3  # gaps between those that are tried as a step
_FEWEST = 10  # changes; a constant reading is a multiple of any step
_SINGLE = 2.0**-22  # of the largest value: the digits of numbers in single precision, which some files have


def steps(readings: Readings) -> dict[str, float]:
    """Return the step of every reading that changes by whole steps, by name [SI].

    The zero of the steps is free. A step far below the noise is found too, unless the values are so sparse that no two
    of them are neighbours.
    """
    found = {}
    for name in READINGS:
        values = readings[name]
        starts = np.linspace(0, max(len(values) - _LENGTH, 0), _PIECES).astype(np.int64)
        changes = np.concatenate([np.diff(values[start : start + _LENGTH]) for start in starts])
        changes = changes[np.isfinite(changes)]
        if name == "spin_angle":
            changes = changes[changes >= 0.0]  # a turn is not always a whole number of steps
        if np.count_nonzero(changes) < _FEWEST:
            continue
        digit = float(np.finfo(np.float64).eps) * float(np.nanmax(np.abs(values), initial=0.0))
        step = _step(np.unique(np.abs(changes)), _ROUNDING * digit)
        if step > _SINGLE * digit / np.finfo(np.float64).eps:
            found[name] = step
    return found


def _step(values: Array, digit: float) -> float:
    """Return the step of which nearly all of sorted values, rounded to `digit`, are whole multiples; 0 if none is."""
    gaps = np.diff(values, prepend=0.0)
    gaps = np.sort(gaps[gaps > digit])
    # where values are many, the smallest gap is one step, unless a value is off
    for step in gaps[: 4 * _TRIES : _TRIES]:
        if _NEAR * step < 4.0 * digit:
            continue
        # a step that is slightly off misses large values: it is refined on ever larger ones
        for reach in np.geomspace(10.0 * step, max(float(values[-1]), 10.0 * step), 8):
            some = values[values <= reach]
            whole = np.round(some / step)
            some, whole = (x[np.abs(some - whole * step) <= 0.1 * step] for x in (some, whole))
            if np.any(whole):
                step = float(whole @ some) / float(whole @ whole)
        off = np.abs(values - np.round(values / step) * step) > _NEAR * step + digit
        if off.mean() <= _MOST_OFF:
            return float(step)
    return 0.0


_UNIFORM = 12.0  # variance of rounding: step² over this


@dataclass(frozen=True)
class Shown:
    """The instruments of a recording as its samples show them.

    Attributes
    ----------
    lines : tuple of Line
        Hum at multiples of the mains; at the stated frequency wherever it can be measured.
    hum_unknown : str
        Reason why hum at the stated frequency cannot be measured (`hum.unobservable`).
    steps : dict of str to float
        Step of each reading that changes by whole steps, by reading [SI].
    noise : dict of str to float
        White noise of the readings, by its name in the bench file [SI].
    outliers : dict of str to Outliers
        Outliers of the readings whose noise is not Gaussian, by channel.
    stamps : Stamps or None
        The clock by its stamps.
    spin : float
        Highest speed of the steady motion [rad/s].
    commanded : bool
        Whether the commands are known, relative to which the noise of the coil voltages is measured.
    held : dict of str to float
        Samples over which each slow reading is repeated, where that is more than one. Of others it is a wrong setup.
    """

    lines: tuple[Line, ...] = ()
    hum_unknown: str = ""
    steps: dict[str, float] = field(default_factory=dict)
    noise: dict[str, float] = field(default_factory=dict)
    outliers: dict[str, Outliers] = field(default_factory=dict)
    stamps: Stamps | None = None
    spin: float = 0.0
    commanded: bool = False
    held: dict[str, float] = field(default_factory=dict)

    def weighed(self, windows: Windows, elsewhere: Sequence[Shown] = ()) -> Windows:
        """Return the windows with the noise that hum and steps add.

        Hum that recordings of the same machine `elsewhere` show counts too, even where a speed of this recording
        conceals it. Rounding is in the measured noise of a reading, but not in that of coil voltages without commands.
        """
        if not len(windows):
            return windows
        noise = windows.reading_noise.copy()
        step = max(self.steps.get(f"coil_voltage_{axis}", 0.0) for axis in "xy")
        k = READING_NOISES.index("coil_voltage_noise")
        if not self.commanded:
            noise[:, k] = np.sqrt(noise[:, k] ** 2 + step**2 / _UNIFORM)
        return replace(
            windows, reading_noise=noise, hum_variance=hum_variance(self._lines_with(elsewhere), windows)
        )

    def _lines_with(self, elsewhere: Sequence[Shown]) -> list[Line]:
        """Return its lines, and the lines of other recordings beyond them; of several the first."""
        lines = list(self.lines)
        for line in (line for other in elsewhere for line in other.lines):
            known = {
                channel
                for own in lines
                if (own.mains, own.multiple) == (line.mains, line.multiple)
                for channel in own.found
            }
            if further := line.found - known:
                lines.append(replace(line, found=further))
        return lines


def look(data: Samples, windows: Windows, bench: Bench) -> Shown:
    """Return the instruments as the samples of a recording and its steady windows show them; `bench` is as stated."""
    period = data.period(bench.sample_period)
    stamps = None if data.sequence is None else read_stamps(data, data.sequence, period)
    if stamps is not None and period != bench.sample_period:
        stamps = replace(stamps, stated=stamps.period)  # the rate of another logger is stated nowhere
    if not len(windows):
        return Shown(stamps=stamps)
    if data.absent:
        data, _, _ = readable(data, bench)
    return Shown(
        tuple(find_lines(data, windows, bench)),
        unobservable(windows, bench.value("mains_frequency")),
        steps(data.readings),
        dict(zip(READING_NOISES, np.median(windows.reading_noise, axis=0).tolist(), strict=True)),
        outliers(data, [(start, stop) for start, stop, *_ in steady_spans(data)], period),
        stamps,
        float(windows.mean_spin.max()),
        data.commanded is not None,
        held=_held(data, bench),
    )


def _held(data: Samples, bench: Bench) -> dict[str, float]:
    """Return over how many samples slow readings are repeated."""
    numbers = np.arange(len(data.time)) if data.sequence is None else data.sequence.astype(np.int64)
    return held_readings(data.readings, data.time, numbers, bench, tuple(ASSUMED))


Remark = Literal["", "heavy_tails", "bursts", "sampled", "stamped", "hidden", "stamps_off", "sampling_off"]


@dataclass(frozen=True)
class ReadingFinding:
    """A property of an instrument, as the samples show it, that differs from the bench file.

    Attributes
    ----------
    name : str
        The parameter of the bench that describes it.
    channel : str
        The reading, ``mains`` or ``clock``.
    quantity : str
        ``hum``, ``held``, ``resolution``, ``outliers``, ``frequency``, ``jitter`` or ``rate_error``.
    value, standard_error : float
        Estimate from the samples [`unit`].
    stated : float
        Value of the bench file.
    unit : str
        SI unit.
    delta_chi2 : float or None
        Square of the difference in standard errors; None for steps and outliers, which are certain.
    recording : str
        The recording that shows it most clearly.
    frequency : float or None
        Of a hum [Hz].
    multiple : int
        Multiple of the mains frequency.
    remark : str
        Of outliers: they come one by one (``heavy_tails``) or in ``bursts``. Of jitter: the samples are taken at their
        stamps (``sampled``), only the stamps scatter (``stamped``), or the samples jitter and the stamps do not show it
        (``hidden``). Of the rate: the reading of the speed agrees with the count of the samples (``stamps_off``) or
        with the stamps (``sampling_off``).
    """

    name: str
    channel: str
    quantity: str
    value: float
    standard_error: float
    stated: float
    unit: str
    delta_chi2: float | None
    recording: str
    frequency: float | None = None
    multiple: int = 1
    remark: Remark = ""


@dataclass(frozen=True)
class ReadingFindings:
    """Deviations of the instruments from the bench file that the samples show.

    Attributes
    ----------
    found : tuple of ReadingFinding
        The deviations.
    hum_unknown : tuple of (str, str)
        Recordings in which hum at the stated mains frequency cannot be measured, and why (`hum.unobservable`).
    """

    found: tuple[ReadingFinding, ...] = ()
    hum_unknown: tuple[tuple[str, str], ...] = ()


def reading_findings(shown: Sequence[Shown], names: Sequence[str], bench: Bench) -> ReadingFindings:
    """Return the deviations of the instruments from the bench as stated, given the `shown` ones of recordings."""
    clearest: dict[tuple[str, int, float], ReadingFinding] = {}
    for own, name in zip(shown, names, strict=True):
        every = (
            _helds(own, name),
            _hums(own, name, bench),
            _steps(own, name, bench),
            _outliers(own, name),
            _clock(own, name, bench),
        )
        for item in itertools.chain(*every):
            key = (item.name, item.multiple, round(item.frequency or 0.0, -1))
            known = clearest.get(key)
            if known is None or (item.delta_chi2 or item.value) > (known.delta_chi2 or known.value):
                clearest[key] = item
    return ReadingFindings(
        tuple(clearest.values()),
        tuple((name, own.hum_unknown) for own, name in zip(shown, names, strict=True) if own.hum_unknown),
    )


def _hums(own: Shown, recording: str, bench: Bench) -> list[ReadingFinding]:
    mains = bench.value("mains_frequency")
    result = []
    for line in own.lines:
        fundamental = line.mains == mains and line.multiple == 1
        for channel, (value, error) in line.amplitudes.items():
            stated = bench.value(f"{channel}_hum") if fundamental else 0.0
            if not fundamental and channel not in line.found:
                continue
            # an amplitude whose presence is uncertain is only an upper limit
            if channel not in line.found and value + CLEAR_READING * error > stated:
                continue
            off = abs(value - stated)
            if off > CLEAR_READING * error and off > HUM_PART * own.noise.get(f"{channel}_noise", 0.0):
                result.append(
                    ReadingFinding(
                        f"{channel}_hum", channel, "hum", value, error, stated, bench.parameters[f"{channel}_hum"].unit,
                        (off / error) ** 2, recording, line.frequency, line.multiple,
                    )
                )  # fmt: skip
        if fundamental and line.found:
            result += _mains(line, recording, mains)
    return result


def _mains(line: Line, recording: str, stated: float) -> list[ReadingFinding]:
    off = abs(line.frequency - stated)
    if off <= max(CLEAR_READING * line.frequency_error, MAINS_FREQUENCY * stated):
        return []
    chi2 = (off / line.frequency_error) ** 2
    return [
        ReadingFinding(
            "mains_frequency", "mains", "frequency", line.frequency, line.frequency_error, stated, "Hz", chi2, recording
        )
    ]  # fmt: skip


def _steps(own: Shown, recording: str, bench: Bench) -> list[ReadingFinding]:
    widest: dict[str, float] = {}
    for reading in READINGS:
        name = _resolution(reading)
        widest[name] = max(widest.get(name, 0.0), own.steps.get(reading, 0.0))
    result = []
    for name, step in widest.items():
        stated, channel = bench.value(name), name.removesuffix("_resolution")
        noise = own.noise.get(f"{channel}_noise", bench.value(f"{channel}_noise"))
        larger = max(step, stated)
        if abs(step - stated) > SAME_STEP * larger and larger > STEP_PART * noise and own.spin > 0.0:
            unit = bench.parameters[name].unit
            result.append(
                ReadingFinding(name, channel, "resolution", step, 0.0, stated, unit, None, recording)
            )
    return result


def _outliers(own: Shown, recording: str) -> list[ReadingFinding]:
    result = []
    for channel, shown in own.outliers.items():
        remark: Remark = "bursts" if shown.together >= BURST_OUTLIERS else "heavy_tails"
        finding = ReadingFinding(
            f"{channel}_noise",
            channel,
            "outliers",
            shown.share,
            0.0,
            0.0,
            "1",
            None,
            recording,
            remark=remark,
        )
        result.append(finding)
    return result


def _helds(own: Shown, recording: str) -> list[ReadingFinding]:
    return [
        ReadingFinding(f"{name}_held", name, "held", rows, 0.0, 1.0, "1", None, recording)
        for name, rows in own.held.items()
    ]


def _resolution(reading: str) -> str:
    """Return the parameter that states the step of a reading."""
    for channel in ("tilt", "coil_voltage", "temperature", "pressure"):
        if reading.startswith(channel) or reading.endswith(channel):
            return f"{channel}_resolution"
    return f"{reading}_resolution"


def _clock(own: Shown, recording: str, bench: Bench) -> list[ReadingFinding]:
    stamps = own.stamps
    if stamps is None or not own.spin > 0.0:
        return []
    result = []
    noise = own.noise.get("spin_angle_noise", bench.value("spin_angle_noise"))

    def jitter(value: float, error: float, stated: float, remark: Remark) -> ReadingFinding:
        chi2 = ((value - stated) / error) ** 2
        return ReadingFinding(
            "clock_jitter", "clock", "jitter", value, error, stated, "s", chi2, recording, remark=remark
        )

    stated = bench.value("clock_jitter")
    off = abs(stamps.jitter - stated)
    if off > CLEAR_READING * stamps.jitter_error and own.spin * off > JITTER_PART * noise:
        remark: Remark = ""
        if stamps.sampled_error < 0.1:
            remark = "sampled" if stamps.sampled > 0.5 else "stamped"
        result.append(jitter(stamps.jitter, stamps.jitter_error, stated, remark))
    elif (
        stamps.hidden > CLEAR_HIDDEN_JITTER * stamps.hidden_error
        and own.spin * stamps.hidden > HIDDEN_PART * noise
    ):
        result.append(jitter(stamps.hidden, stamps.hidden_error, 0.0, "hidden"))
    period, rate_stated = stamps.stated, bench.value("clock_rate_error")
    rate, error = stamps.period / period - 1.0, stamps.period_error / period
    off = abs(rate - rate_stated)
    if off > max(CLEAR_READING * error, CLOCK_RATE):
        side: Remark = ""
        known = math.isfinite(stamps.counter) and 3.0 * stamps.counter_error < RATE_AGREES * abs(rate)
        if known and abs(stamps.counter + rate) < RATE_AGREES * abs(rate):
            side = "stamps_off"
        elif known and abs(stamps.counter) < RATE_AGREES * abs(rate):
            side = "sampling_off"
        result.append(
            ReadingFinding(
                "clock_rate_error", "clock", "rate_error", rate, error, rate_stated, "1",
                (off / error) ** 2, recording, remark=side,
            )
        )  # fmt: skip
    return result
