"""Wrong setups of a recording: searched before anything is fitted to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrowheel_core import cache
from gyrowheel_core.arrays import one_thread
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.reader import require_rate
from gyrowheel_recording.mislabelled import Fix, WrongSetup
from gyrowheel_recording.mislabelled.blocks import (
    BLOCK,
    COIL,
    NAMES,
    TILT,
    Array,
    Averages,
    averages,
    block_at,
    block_times,
    blocks_of,
    never_measured,
)
from gyrowheel_recording.mislabelled.held import held_setup
from gyrowheel_recording.mislabelled.relations import (
    Ratio,
    precession,
    precession_ratio,
    slews,
    spin_up_ratio,
)
from gyrowheel_recording.mislabelled.spin import SPINNING, wrong_spin_columns
from gyrowheel_recording.mislabelled.tilt import harmonics, wrong_tilt_columns
from gyrowheel_sim.bench import Bench

#: Entry in the user's cache of recordings whose setup was found right by the same code, and the number of those kept.
_RIGHT, _MOST = b"right", 1000
_CODE = ("gyrowheel_core", "gyrowheel_sim", "gyrowheel_recording")
#: Pascals in a unit of pressure.
_PRESSURES = {"hPa": 100.0, "kPa": 1000.0, "bar": 1e5, "mmHg": 133.322, "psi": 6894.76}
#: Weather and height above the sea move the pressure by less than this part.
_WEATHER = 0.12
_COLDEST = 150.0  # K; the coldest that a bench is used at
_CELSIUS = 273.15
_ROOM = (-30.0, 120.0)  # deg C
_TEMPERATURES = ("coil_temperature", "air_temperature")


def wrong_air_units(recording: Recording, bench: Bench) -> list[WrongSetup]:
    """Return which readings of pressure and temperature are in another unit."""
    found = []
    pressures = recording.readings.air_pressure / _ratio(recording)
    pressure = _median(pressures)
    if np.isfinite(pressure) and pressure > 0.0 and _steady(pressures):
        stated = bench.value("air_pressure")
        # a reading that is as it should be is never asked for its unit
        if abs(pressure / stated - 1.0) > 3.0 * _WEATHER:
            near = {unit: abs(pressure * size / stated - 1.0) for unit, size in _PRESSURES.items()}
            unit = min(near, key=lambda name: near[name])
            if near[unit] < _WEATHER:
                fix = Fix(scale={"air_pressure": _PRESSURES[unit]})
                found.append(WrongSetup("unit", ("air_pressure",), fix, unit, value=pressure))
    cold = [name for name in _TEMPERATURES if _is_celsius(recording.readings[name])]
    if cold:
        value, fix = _median(recording.readings[cold[0]]), Fix(offset=dict.fromkeys(cold, _CELSIUS))
        found.append(WrongSetup("unit", tuple(cold), fix, "deg C", value=value))
    return found


def _is_celsius(values: Array) -> bool:
    known = values[np.isfinite(values)]
    if not len(known):
        return False
    low, middle = float(known.min()), float(np.median(known))
    return middle < _COLDEST and low > _ROOM[0] - 100.0 and _ROOM[0] < middle < _ROOM[1]


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def _ratio(recording: Recording) -> Array:
    """Return the pressure that was planned over the ambient one; NaN for a vacuum."""
    ratio = np.ones(len(recording.time))
    for event in recording.environment:
        ratio[recording.time >= event.time] = event.air_density_ratio or np.nan
    return ratio


def _steady(values: Array) -> bool:
    """Whether a pressure stays: one that is pumped off unplanned is no ambient pressure in another unit."""
    first, last = np.percentile(values[np.isfinite(values)], (20.0, 80.0))
    return bool(last - first < 0.1 * last)


_SHORTEST = 3.0  # s at one value
_SPEED = 0.02  # relative change of the speed that voltage, current and speed reading must follow


def stuck_columns(recording: Recording, blocks: Array, bench: Bench) -> list[WrongSetup]:
    """Return the columns that stay at one value for seconds while what they must follow moves."""
    found = []
    for name in NAMES:
        first, last = _longest(recording.readings[name])
        if last == first:
            continue
        begin, end = (float(recording.time[k]) for k in (first, last))
        if end - begin < _SHORTEST:
            continue
        inside = slice(block_at(recording, begin), block_at(recording, end))
        if _must_move(name, inside, blocks, bench):
            found.append(WrongSetup("stuck", (name,), value=float(recording.readings[name][first])))
    return found


def _longest(values: Array) -> tuple[int, int]:
    """Return the first and the last sample of the longest run of one value."""
    edges = np.r_[0, np.flatnonzero(np.diff(values) != 0.0) + 1, len(values)]
    k = int(np.argmax(np.diff(edges)))
    return int(edges[k]), int(edges[k + 1]) - 1


def _must_move(name: str, inside: slice, blocks: Array, bench: Bench) -> bool:
    rows = blocks[inside]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < 2:
        return False
    columns = dict(zip(NAMES, rows.T, strict=True))
    if name == "spin_angle":
        # at a voltage or a speed the angle turns, whatever the units
        return bool(np.abs(np.median(columns["spin_rate"])) > 0.0 or np.any(columns["motor_voltage"]))
    if name == "spin_rate":
        return _moves(columns["spin_angle"])
    if name in ("motor_voltage", "motor_current"):
        return _moves(columns["spin_angle"]) or _moves(columns["spin_rate"])
    # the torque that the precession of the other axis takes, against the torque of the flexures at full tilt
    most = bench.value("flexure_stiffness_x") * bench.value("tilt_limit")
    if name.startswith("tilt"):
        across = columns["coil_voltage_y" if name == "tilt_x" else "coil_voltage_x"]
        return bool(bench.value("coil_constant") * _range(across) > 2.0 * most)
    across = columns["tilt_y" if name == "coil_voltage_x" else "tilt_x"]
    slew = bench.precession_inertia * np.median(np.abs(columns["spin_rate"])) * np.gradient(across, BLOCK)
    return bool(_range(slew) > 2.0 * most)


def _moves(values: Array) -> bool:
    return bool(_range(values) > _SPEED * np.abs(np.median(values)))


def _range(values: Array) -> float:
    """Return the range of values averaged over a tenth of a second, so that neither ripple nor noise counts."""
    width = round(0.2 / BLOCK)
    if len(values) < 2 * width:
        return 0.0
    smooth = np.convolve(values, np.full(width, 1.0 / width), mode="valid")
    return float(np.ptp(smooth))


#: Inertias of one machine differ by less, whatever its effects: heated coils change their torque by a tenth.
_DIFFERENT = math.log(1.28)
_CERTAIN = 8.0  # standard errors


def other_machines(
    recordings: Sequence[Recording], averages: Sequence[Averages], bench: Bench
) -> list[WrongSetup]:
    """Return the recordings that state another machine than an earlier one, or show other inertias.

    Where both state their machine, nothing else counts. The setups of the recordings are right; `averages` has
    those of each, and its inertias are compared by their ratios to those of the bench.
    """
    found = []
    known: list[tuple[Recording, tuple[Ratio, ...]]] = []
    for recording, own in zip(recordings, averages, strict=True):
        shown = precession_ratio(own, bench), spin_up_ratio(own, bench)
        for other, theirs in known:
            if recording.machine and other.machine:
                if recording.machine != other.machine:
                    found.append(_another(recording, other))
                    break
                continue
            far = [_distance(one, two) for one, two in zip(shown, theirs, strict=True)]
            if max(far) > 0.0:
                place = far.index(max(far))
                found.append(_another(recording, other, shown[place].value / theirs[place].value))
                break
        known.append((recording, shown))
    return found


def _another(recording: Recording, other: Recording, ratio: float = math.nan) -> WrongSetup:
    found = WrongSetup("another_machine", ("rotor inertia",), value=ratio, recording=str(recording.path))
    return replace(found, unit=str(other.path))


def _distance(one: Ratio, other: Ratio) -> float:
    """Return by how much two inertias certainly differ (logarithm of their ratio); 0 where they may be equal."""
    if not (one.value > 0.0 and other.value > 0.0):
        return 0.0
    apart = abs(math.log(one.value / other.value))
    error = math.hypot(one.error / one.value, other.error / other.value)
    return apart if apart > _DIFFERENT and apart > _CERTAIN * error else 0.0


_AROUND = 0.5  # s before and after a change of the rate table


def wrong_setups(recordings: Sequence[Recording], bench: Bench, *, mixed: bool = False) -> list[WrongSetup]:
    """Return the wrong setups of some recordings.

    A setup is accused only where physics fails far beyond what any effect or tolerance can do, and a plain change of
    the columns makes it hold.

    Parameters
    ----------
    recordings : sequence of Recording
        The recordings, each judged alone.
    bench : Bench
        The bench as stated.
    mixed : bool
        Whether recordings of different machines are wanted; if not, their inertias must agree.

    Raises
    ------
    InputError
        If the samples of a recording are too far apart for any judgement.
    """
    contents = [recording.content for recording in recordings]
    about = (cache.files_of(*_CODE), np.__version__, str(mixed), repr(bench.stated))
    name = f"setups_{cache.digest(*about, *contents)}"
    if cache.read(name) == _RIGHT:
        return []
    found, averaged = [], []
    # the matrices are small: several threads would only wait for each other
    with one_thread():
        for recording in recordings:
            wrong, now = _judged(recording, bench)
            found += [replace(item, recording=str(recording.path)) for item in wrong]
            averaged.append(now)
        if not found and len(recordings) > 1 and not mixed:
            found = other_machines(recordings, averaged, bench)
    if not found:
        cache.write(name, _RIGHT)
        cache.keep_latest("setups_", _MOST)
    return found


def _judged(recording: Recording, bench: Bench) -> tuple[list[WrongSetup], Averages]:
    """Return the wrong setups of one recording, and its uncorrected averages."""
    require_rate(recording)
    absent = never_measured(recording)
    numbers = recording.measurement["sequence"].astype(np.int64)
    if held := held_setup(recording.readings, recording.time, numbers, absent, bench):
        nothing = np.zeros((0, len(NAMES)))
        return held, Averages(nothing, nothing, nothing, absent)  # nothing else can be judged by them
    blocks = blocks_of(recording, absent=absent)
    now = averages(_at_rest(recording, blocks), absent)
    still = stuck_columns(recording, blocks, bench) if len(blocks) else []
    return [*wrong_air_units(recording, bench), *(still or _of_motion(recording, now, bench))], now


def _of_motion(recording: Recording, now: Averages, bench: Bench) -> list[WrongSetup]:
    """Return what is wrong with the columns that move."""
    if not len(now):
        return []
    wrong = wrong_spin_columns(recording, now, bench)
    if not wrong:
        return _of_tilt(recording, now, bench, 1.0)
    # where several changes explain the spin as well, the precession decides
    wrong.sort(key=lambda item: round(precession(item[1], bench), 1))
    if wrong[0][0].kind == "clock":
        return [wrong[0][0]]  # the law of precession cannot be judged by such times
    others: list[WrongSetup] = []
    for own, mended in wrong:
        further = _of_tilt(recording, mended, bench, own.cure.scale.get(SPINNING[0], 1.0))
        if not further:
            return [own]
        others = others or further
    return [wrong[0][0], *others]


def _of_tilt(recording: Recording, now: Averages, bench: Bench, angle_factor: float) -> list[WrongSetup]:
    """Return what is wrong with tilts and coil voltages, or with the direction of the spin."""
    speed = now.rate[np.isfinite(now.rate)]
    if not len(speed) or np.median(speed) > 0.0:
        turning = harmonics(recording, angle_factor=angle_factor, absent=now.absent)
        return wrong_tilt_columns(recording, now, bench, turning)
    if not now.measured(*TILT) or now.absent >= set(COIL) or not slews(now, bench):
        return []
    # the wheel turns the other way, or the signs of all that belongs to the spin are turned
    measured = [name for name in SPINNING if now.measured(name)]
    signs = Fix(scale=dict.fromkeys(measured, -1.0))
    mirror = Fix(scale=dict.fromkeys((TILT[1], COIL[1]), -1.0))
    own, other = (precession(a, bench) for a in (now, signs.applied(now)))
    if own < other:
        return [WrongSetup("reversed", SPINNING, signs.and_then(mirror), before=other, after=own)]
    return [WrongSetup("sign", SPINNING, signs, before=own, after=other)]


def _at_rest(recording: Recording, blocks: Array) -> Array:
    """Return the blocks in which no rate table turns the rig: the coils then hold more than the tilt needs."""
    if not any(event.table_rate for event in recording.environment):
        return blocks
    time = block_times(recording, len(blocks))
    turned = np.zeros(len(blocks), dtype=bool)
    for event in recording.environment:
        turned[time >= event.time - _AROUND] |= bool(event.table_rate)
        if not event.table_rate:
            turned[time >= event.time + _AROUND] = False
    return np.where(turned[:, None], np.nan, blocks)
