"""What the samples show of the instruments beside what the bench states: hum, steps of converters, the clock.

None of it turns a torque, so none of it is an effect: the verdict stays as it is without them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gyrowheel_analysis.criteria import (
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
from gyrowheel_analysis.reduction.hum import Line
from gyrowheel_analysis.reduction.shown import Shown
from gyrowheel_core.readings import READINGS
from gyrowheel_sim.bench import Bench

Remark = Literal["", "sampled", "stamped", "hidden", "stamps_off", "sampling_off"]


@dataclass(frozen=True)
class ReadingFinding:
    """Something about an instrument that the samples show, and that is not as the bench states it.

    Attributes
    ----------
    name : str
        The parameter of the bench that describes it.
    channel : str
        The reading, ``mains`` or ``clock``.
    quantity : str
        ``hum``, ``resolution``, ``frequency``, ``jitter`` or ``rate_error``.
    value, standard_error : float
        What the samples show [`unit`].
    stated : float
        What the bench states.
    unit : str
        SI unit.
    delta_chi2 : float or None
        Square of the difference in standard errors; None for steps, which are there or not.
    recording : str
        In which recording it shows most clearly.
    frequency : float or None
        Of a hum [Hz].
    multiple : int
        Which multiple of the mains frequency it is.
    remark : str
        Of jitter: whether the samples are taken when the stamps say (``sampled``), only the stamps scatter
        (``stamped``), or the samples jitter and the stamps do not show it (``hidden``). Of the rate: whether the
        reading of the speed goes with the count of the samples (``stamps_off``) or with the stamps (``sampling_off``).
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
    """What the samples show beside what is stated.

    Attributes
    ----------
    found : tuple of ReadingFinding
        What is not as stated.
    untold : tuple of (str, str)
        Recordings in which hum at the stated mains frequency cannot be told, and why (`reduction.hum.untold`).
    """

    found: tuple[ReadingFinding, ...] = ()
    untold: tuple[tuple[str, str], ...] = ()


def reading_findings(shown: Sequence[Shown], names: Sequence[str], bench: Bench) -> ReadingFindings:
    """Return what the samples of recordings show that the bench does not state.

    Parameters
    ----------
    shown : sequence of Shown
        What each recording shows.
    names : sequence of str
        The recordings.
    bench : Bench
        The bench as stated.
    """
    clearest: dict[tuple[str, int, float], ReadingFinding] = {}
    for own, name in zip(shown, names, strict=True):
        for item in (*_hums(own, name, bench), *_steps(own, name, bench), *_clock(own, name, bench)):
            key = (item.name, item.multiple, round(item.frequency or 0.0, -1))
            if key not in clearest or (item.delta_chi2 or 0.0) > (clearest[key].delta_chi2 or 0.0):
                clearest[key] = item
    return ReadingFindings(
        tuple(clearest.values()),
        tuple((name, own.untold) for own, name in zip(shown, names, strict=True) if own.untold),
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
            # an amplitude whose presence is not certain says nothing but that it is not larger
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
            "mains_frequency",
            "mains",
            "frequency",
            line.frequency,
            line.frequency_error,
            stated,
            "Hz",
            chi2,
            recording,
        )
    ]


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
