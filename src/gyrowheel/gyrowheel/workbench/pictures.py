"""Numbers for the pictures of the page: signals, holds, events, fall of the error; all that was found."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrowheel.air_flow.picture import section
from gyrowheel.diagnosis.picture import at_speed, tilts_of
from gyrowheel.drag_comparison.page import agreement_sentence
from gyrowheel.drag_comparison.picture import tilts
from gyrowheel.show.figure import columns, finished, png_bytes, style
from gyrowheel.show.sentences.correction import PLACES, range_text
from gyrowheel.show.sentences.findings import event_sentence
from gyrowheel.workbench import coefficients, windows
from gyrowheel.workbench.library import ROLES, Envelope, Opened
from gyrowheel.workbench.residual import residuals
from gyrowheel.workbench.session import Session
from gyrowheel_air.flow import shipped
from gyrowheel_air.geometry import Geometry
from gyrowheel_analysis.drag.agreement import agreement
from gyrowheel_analysis.drag.estimate import Estimate
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM, unit_for
from gyrowheel_core.wire import SECOND
from gyrowheel_sim.bench import Bench

Array = NDArray[np.float64]

_MOST_POINTS = 4000
_SETPOINT_POINTS = 800
_MILLI = 1e3
_ACTUATORS = ("coil x", "coil y", "motor")
#: Rows of the holds, by actuator: coil voltages and motor current, with the constants that turn them into torques.
_LEVELS = (
    ("coil_voltage_x", "coil_constant"),
    ("coil_voltage_y", "coil_constant"),
    ("motor_current", "motor_constant"),
)
_PER_SECOND = 30.0  # states of the rotor
_MOST_STATES = 3000
_MOST_GAPS = 200
_MAP_CELLS = 23  # across the tilts
_MAP_SPEEDS = 5


def signal(session: Session, key: str, begin: float, end: float, points: int) -> bytes:
    """Return the signals of an open recording from `begin` to `end` [s], with at most `points` points a line.

    Two little-endian blocks, measurement and setpoints. Each has the number of points and their times [s] as float64,
    then the values as float32 for each column of the panels in its unit (of the setpoints: existing columns only),
    padded with zeros to a multiple of 8 bytes. The measurement ends with the derived channels.
    """
    own = _opened(session, key)
    _require_span(begin, end)
    data = own.recording.data
    asked = min(max(points, 4), _MOST_POINTS)
    derived = session.derived.of(own.recording, session.step.model.bench)
    blocks = _block(
        {**own.signals, **derived}, own.recording.time, begin, end, asked, dict.fromkeys(derived, 1.0)
    )
    if len(data.setpoint):
        times = data.seconds(data.setpoint["stamp_ns"])
        return blocks + _block(own.setpoints, times, begin, end, min(asked, _SETPOINT_POINTS))
    return blocks + np.zeros(1, "<f8").tobytes()


def _block(
    signals: Mapping[str, Envelope],
    times: Array,
    begin: float,
    end: float,
    points: int,
    more: Mapping[str, float] = MappingProxyType({}),
) -> bytes:
    first, last = np.searchsorted(times, [begin, end])
    first, last = max(int(first) - 1, 0), min(int(last) + 1, len(times))
    parts: list[bytes] = []
    for name, size in (*columns(), *more.items()):
        if name in signals:
            places, values = signals[name].cut(first, last, points)
            if not parts:
                at = _between(times, places)
                parts += [np.array([len(at)], "<f8").tobytes(), at.astype("<f8").tobytes()]
            parts.append((values / size).astype("<f4").tobytes())
    whole = b"".join(parts)
    return whole + bytes(-len(whole) % 8)


def _between(times: Array, places: Array) -> Array:
    """Return the times of positions between samples; beyond the last sample its time."""
    low = np.minimum(places.astype(np.int64), len(times) - 1)
    high = np.minimum(low + 1, len(times) - 1)
    return times[low] + (places - low) * (times[high] - times[low])


def sample(session: Session, key: str, time: float) -> dict[str, Any]:
    """Return the sample nearest to a time: its number, time [s] and columns in their units."""
    own = _opened(session, key)
    times = own.recording.time
    if not np.isfinite(time) or not len(times):
        raise InputError(f"time: {time:g} s must be finite, and the recording must have samples")
    k = int(np.clip(np.searchsorted(times, time), 1, len(times) - 1)) if len(times) > 1 else 0
    if k and time - times[k - 1] < times[k] - time:
        k -= 1
    row = own.recording.measurement[k]
    return {
        "sample": int(row["sequence"]),
        "time": float(times[k]),
        "values": [
            *(float(row[name]) / size for name, size in columns()),
            *(
                float(each.values[k])
                for each in session.derived.of(own.recording, session.step.model.bench).values()
            ),
        ],
    }


def motion(session: Session, key: str, begin: float, end: float) -> dict[str, Any]:
    """Return states of the rotor in a span of time, for the view in three dimensions.

    Each is a mean over a thirtieth of a second, longer in a long span: time [s], tilt [rad], spin rate [rad/s], coil
    torque from voltages and the coil constant of the model [N·m].
    """
    own = _opened(session, key)
    _require_span(begin, end)
    times, rows = own.recording.time, own.recording.measurement
    first, last = np.searchsorted(times, [begin, end])
    count = int(min(max((end - begin) * _PER_SECOND, 1.0), _MOST_STATES, max(last - first, 1)))
    edges = np.unique(np.linspace(first, last, count + 1).astype(np.int64))[:-1]
    if not len(edges) or last <= first:
        return {"time": [], "tilt_x": [], "tilt_y": [], "spin": [], "torque_x": [], "torque_y": []}
    width = np.diff(np.append(edges, last))

    def means(column: Any, scale: float = 1.0) -> list[float]:
        some = np.nan_to_num(np.asarray(column[first:last], dtype=float))
        found: list[float] = (np.add.reduceat(some, edges - first) / width * scale).tolist()
        return found

    coil = session.step.model.bench.value("coil_constant")
    return {
        "time": means(times),
        "tilt_x": means(rows["tilt_x"]),
        "tilt_y": means(rows["tilt_y"]),
        "spin": means(rows["spin_rate"]),
        "torque_x": means(rows["coil_voltage_x"], coil),
        "torque_y": means(rows["coil_voltage_y"], coil),
    }


def found(session: Session) -> dict[str, Any]:
    """Return the results for the pictures."""
    return {
        "facts": session.facts,
        "windows": windows.windows(session),
        "maps": windows.maps(session),
        "variables": windows.variables(session),
        "torque_maps": torque_maps(session),
        "residuals": residuals(session),
        "models": session.model_files(),
        "estimates": coefficients.shown(session.step.estimates),
        "holds": holds(session),
        "events": events(session),
        "fall": fall(session),
        "geometry": geometry(session),
    }


def geometry(session: Session) -> dict[str, float] | None:
    """Return the lengths of rotor and case over the radius of the rotor, for a bench whose geometry is shipped."""
    own = Geometry.load()
    if session.step.model.bench.name != own.name:
        return None
    return {name: length.value / own.rotor_radius for name, length in own.lengths.items()}


@functools.cache
def flow(which: str) -> bytes:
    """Return the computed flow of the air around the rotor as PNG: its ``"axial"`` or ``"radial"`` velocity."""
    with style():
        found = section(shipped(), which)
        assert found is not None
        return png_bytes(finished(found[0]))


def holds(session: Session) -> dict[str, Any]:
    """Return measured and predicted torques and voltages of every hold, by the key of the recording.

    Torques in mN·m, voltage changes from the reference hold in mV; levels of coil voltage [V] and motor current [A] for
    the panels of the signals. ``before`` is the prediction of the previous model in this session, null without one.
    """
    step = session.step
    before = {} if session.previous is None else session.previous.holds
    return {
        key: _holds(own, session.opened[key].recording.data.start_ns, before.get(key, ()), step.model.bench)
        for key, own in step.holds.items()
        if key in session.opened and own
    }


def heard(session: Session) -> dict[str, Any]:
    """Return the holds of the running benches as `holds` does, from their drag estimators."""
    bench = session.step.model.bench
    return {
        key: _holds(running.holds, running.start_ns, (), bench)
        for key, running in session.live.runs.items()
        if running.holds
    }


def _holds(
    own: Sequence[Estimate], start_ns: int, before: Sequence[Estimate], bench: Bench
) -> dict[str, Any]:
    end = np.array([(e.stamp_ns - start_ns) / SECOND for e in own])
    tilt, title = tilts(own)

    def row(of: Sequence[Estimate], name: str, place: int) -> list[float]:
        return [float(getattr(e, name)[place]) * _MILLI for e in of]

    def series(measured: str, error: str, predicted: str, place: int) -> dict[str, list[float] | None]:
        return {
            "measured": row(own, measured, place),
            "error": row(own, error, place),
            "predicted": row(own, predicted, place),
            "before": row(same, predicted, place) or None,
        }

    same = before if [e.segment for e in before] == [e.segment for e in own] else ()
    voltages = ("voltage_increment", "voltage_increment_std", "simulated_voltage_increment")
    actuators = [
        {
            "title": called,
            "torque": series("measured_torque", "residual_std", "simulated_torque", place),
            "voltage": series(*voltages, place),
            "said": agreement_sentence(own, agreement(own, place, bench), place),
        }
        for place, called in enumerate(_ACTUATORS)
    ]
    levels = {}
    for place, (name, constant) in enumerate(_LEVELS):
        measured = [e.motor_current if place == 2 else float(e.dc_voltage[place]) for e in own]
        levels[name] = {
            "measured": measured,
            "predicted": [
                m - float(e.residual[place]) / bench.value(constant)
                for m, e in zip(measured, own, strict=True)
            ],
        }
    return {
        "start": [float(t) - e.duration for t, e in zip(end, own, strict=True)],
        "end": end.tolist(),
        "hold": [int(e.segment) for e in own],
        "tilt": np.asarray(tilt).tolist(),
        "tilt_title": title,
        "tilt_x": [e.tilt_x / DEG for e in own],
        "tilt_y": [e.tilt_y / DEG for e in own],
        "speed": [e.spin_rate / RPM for e in own],
        "calibrated": all(e.calibrated for e in own),
        "actuators": actuators,
        "levels": levels,
    }


def events(session: Session) -> dict[str, list[dict[str, Any]]]:
    """Return the events of the recordings, by their keys: changes found, stops, missing samples."""
    marks: dict[str, list[dict[str, Any]]] = {}
    dated = () if session.step.diagnosis is None else session.step.diagnosis.events
    parts = session.keyed(ROLES[0])
    for own in list(session.opened.values()):
        names = {str(recording.path) for key, recording in parts if key == own.key}
        rows = [
            {"time": e.time, "end": e.end if e.end is not None else e.time, "said": event_sentence(e)}
            for e in dated
            if e.recording in names
        ]
        integrity, samples = own.recording.integrity, own.recording.measurement
        rows += [
            {"time": at, "end": at + length, "said": f"the bench stood still for {length:.3g} s"}
            for at, length in integrity.stalls
        ]
        places = np.searchsorted(samples["sequence"], [first for first, _ in integrity.gaps[:_MOST_GAPS]])
        for (_, length), k in zip(integrity.gaps, places.tolist(), strict=False):
            low, high = (float(own.recording.time[min(max(n, 0), len(samples) - 1)]) for n in (k - 1, k))
            rows.append({"time": low, "end": high, "said": f"{length} samples are missing"})
        marks[own.key] = rows
    return marks


def torque_maps(session: Session) -> list[dict[str, Any]]:
    """Return the map of the diagnosis, one entry a torque, at several speeds; empty without one.

    ``x`` and ``y`` are the tilts [deg] in the range of the map, the middles of cells. Of every speed ``value_x`` and
    ``value_y`` are the torque on the rotor, of the shaft ``value_x`` alone, and ``sigma`` its standard deviation, of
    both axes together. ``shape`` is the part of that, its root mean square, which is neither an offset nor a slope over
    the tilts: bench parameters share those with the map.
    """
    diagnosis = session.step.diagnosis
    found = None if diagnosis is None else diagnosis.map
    if found is None:
        return []
    within, square = found.effect.within, tilts_of(found, _MAP_CELLS) * (1.0 - 1.0 / _MAP_CELLS)
    z = square[np.abs(square) <= within.tilt]
    low, high = within.speed
    speeds = np.linspace(low, high, _MAP_SPEEDS if high - low > RPM else 1)
    states = [at_speed(found, speed, z) for speed in speeds]
    values, errors = ([make(own) for own in states] for make in (found.at, found.errors_at))
    shown = []
    for target in found.targets:
        most = max(float(np.abs(own[target]).max()) for own in values)
        unit = unit_for(most or 1.0, "N·m")

        def row(own: Any, size: float = unit.size) -> list[float]:
            return [float(f"{v:.4g}") for v in np.broadcast_to(own, z.shape) / size]

        shown.append(
            {
                "target": target,
                "title": PLACES[target],
                "range": range_text(found.effect),
                "unit": unit.label,
                "most": most / unit.size,
                "cell": 2.0 * within.tilt / _MAP_CELLS / DEG,
                "x": (z.real / DEG).round(4).tolist(),
                "y": (z.imag / DEG).round(4).tolist(),
                "speeds": [
                    {
                        "speed": round(speed / RPM),
                        "value_x": row(np.real(value[target])),
                        "value_y": row(np.imag(value[target])),
                        "sigma": row(np.sqrt(np.sum(np.abs(error[target]) ** 2, axis=0))),
                        "shape": round(_shape(error[target], z) / unit.size, 6),
                    }
                    for speed, value, error in zip(speeds, values, errors, strict=True)
                ],
            }
        )
    return shown


def _shape(errors: Any, tilt: Any) -> float:
    """Return the root mean square of errors (errors, n) at tilts (n,) without their mean and slopes."""
    plane = np.column_stack([np.ones(len(tilt)), tilt.real, tilt.imag])
    rest = errors.T - plane @ np.linalg.lstsq(plane, errors.T, rcond=None)[0]
    return float(np.sqrt(np.mean(np.sum(np.abs(rest) ** 2, axis=1))))


def fall(session: Session) -> list[dict[str, Any]]:
    """Return the fall of the error in this session, on its present ranges: χ²/N on fitted and validation data."""
    rows: list[dict[str, Any]] = []
    model, ranges = None, session.step.ranges
    for step in list(session.steps):
        before, model, added = model, step.model, step.model.added
        if added is None or model is before or step.ranges != ranges:
            continue
        error, name = added.error, ", ".join(added.coefficients)
        if not rows:
            rows.append({"what": "before", **_chi2(error.before, error.validation_before)})
        rows.append({"what": f"+ {name}", **_chi2(error.after, error.validation_after)})
    for number, row in enumerate(itertools.islice(rows, 1, None), 1):
        if any(row["what"] == other["what"] for other in rows[:number]):
            row["what"] += f" ({number})"
    return rows


def _chi2(fitted: Any, unused: Any) -> dict[str, float | None]:
    return {"fitted": fitted.chi2_per_n, "unused": None if unused is None else unused.chi2_per_n}


def _opened(session: Session, key: str) -> Opened:
    own = session.opened.get(key)
    if own is None:
        raise InputError(f"recording {key!r}: is not open")
    return own


def _require_span(begin: float, end: float) -> None:
    if not (np.isfinite(begin) and np.isfinite(end) and begin < end):
        raise InputError(f"span: {begin:g} to {end:g} s: the end must be after the start")
