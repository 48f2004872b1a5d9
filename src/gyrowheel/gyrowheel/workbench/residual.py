"""Numbers for the pictures of the residual of each channel: measured and predicted, and whether it is noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

from gyrowheel.workbench.library import ROLES
from gyrowheel.workbench.session import Session
from gyrowheel_analysis.channels import CHANNELS, LISTED, Quantity
from gyrowheel_analysis.compare import Comparison
from gyrowheel_analysis.residuals.error_table import Part, Residuals
from gyrowheel_analysis.residuals.orders import TURNS, OrderSpectrum, order_spectrum
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.quantities import number
from gyrowheel_core.units import Unit, unit_for

Array = NDArray[np.float64]

_SIDE = 1.96  # standard deviations to both sides that hold a normal variate in 95 of 100 cases
_LAGS = 20
_REACH = 10  # lags of a cross-correlation to either side
#: What the residual of windows is correlated with.
_MOTION: Mapping[str, Callable[[Residuals], Array]] = {
    "tilt about x": lambda own: np.real(own.tilt),
    "tilt about y": lambda own: np.imag(own.tilt),
    "tilt": lambda own: np.abs(own.tilt),
    "spin rate": lambda own: own.spin_rate,
}
_FEWEST = 4  # windows of a statistic
#: What the samples show of a quantity, in a title.
_SHOWN: Mapping[Quantity, str] = {
    "coil_torque": "coil torque",
    "motor_torque": "motor torque by its current",
    "shaft_torque": "motor torque by its current",
    "motor_voltage": "motor voltage",
    "winding_voltage": "motor voltage",
    "encoder_angle": "angle reading",
}
_MOST_LINES = 5  # of a spectrum over order, in words
_PARTS = {"average": (" x", " y"), "revolution": (", real part", ", imaginary part")}


def residuals(session: Session) -> list[dict[str, Any]]:
    """Return each row of each channel: measured, predicted, residual with its noise, and whether it is noise.

    A row has a value a window, in the order of the windows; the residual and its noise are in a unit of their own.
    ``others`` are the residuals of `other_models` on the same windows, by their titles.
    """
    found = session.step.comparison
    if found is None:
        return []
    others = {title: own.data.parts for title, own in other_models(session).items()}
    rows = []
    for name, part in found.data.parts.items():
        for place in range(len(part.kind.rows)):
            alike = {title: parts[name] for title, parts in others.items()}
            rows.append(_row(name, part, place, alike) | {"noise": _noise(found, name, place)})
    return rows


def other_models(session: Session) -> dict[str, Comparison]:
    """Return what can be drawn over the results of the model, the latest first: earlier and undone models, and files.

    Each by the effects of its model, or the name of its file; only those with the same windows and channels.
    """
    now, found = session.step, session.step.comparison
    if found is None:
        return {}
    models: dict[str, Comparison] = {}
    for step in (*reversed(session.steps), *reversed(session.undone)):
        if step.model is not now.model and step.comparison is not None and step.ranges == now.ranges:
            models.setdefault(" + ".join(step.model.effects) or "no effects", step.comparison)
    models |= session.others
    return {title: own for title, own in models.items() if _same_windows(found, own)}


def _same_windows(one: Comparison, other: Comparison) -> bool:
    starts, before = one.data.windows.start, other.data.windows.start
    same = len(starts) == len(before) and bool(np.allclose(starts, before))
    return same and one.data.parts.keys() == other.data.parts.keys()


def _row(name: str, part: Part, place: int, others: Mapping[str, Part]) -> dict[str, Any]:
    kind = part.kind
    unit = unit_for(float(np.median(np.abs(part.sigma))) or 1.0, kind.unit)
    measured = None if part.measured is None else _side(part.measured, place)
    whole = (
        unit if measured is None else unit_for(float(np.max(np.abs(measured), initial=0.0)) or 1.0, kind.unit)
    )
    several = _PARTS.get(kind.group, _PARTS["revolution"]) if len(kind.rows) > 1 else ("",)

    def shown(own: Array, unit: Unit = unit) -> list[float]:
        return [float(f"{v:.6g}") for v in own / unit.size]

    def left_by(own: Part) -> dict[str, Any]:
        """Return what a model leaves, and what it predicts: the measured row contains both."""
        values = _side(own.values, place)
        return {
            "predicted": None if measured is None else shown(measured - values, whole),
            "residual": shown(values),
            "sigma": shown(own.sigma),
            "chi2": _chi2(own),
        }

    return {
        "channel": name,
        "place": place,
        "title": kind.title + several[place],
        "unit": unit.label,
        "order": kind.order,
        "measured": None if measured is None else shown(measured, whole),
        "measured_unit": whole.label,
        **left_by(part),
        "others": {title: left_by(own) for title, own in others.items()},
    }


def _chi2(part: Part) -> float:
    return float(part.chi2.sum()) / max(part.rows, 1)


def _side(values: NDArray[Any], place: int) -> Array:
    """Return one of the rows of a channel."""
    return np.asarray(np.imag(values) if place else np.real(values))


def _noise(found: Comparison, name: str, place: int) -> dict[str, Any] | None:
    """Return spectrum, autocorrelation and distribution of a whitened residual; None where it has few windows."""
    several = [(own, white) for own in found.residuals if (white := _white(own, name, place)) is not None]
    ordered = [
        (own, w[order], order) for own, w in several for order in [np.argsort(own.time, kind="stable")]
    ]
    pieces = [(own.time[order], w) for own, w, order in ordered]
    every = np.sort(np.concatenate([w for _, w in pieces])) if pieces else np.zeros(0)
    n = len(every)
    if n < _FEWEST or not np.all(np.isfinite(every)) or not every.any():
        return None
    rank = np.arange(1, n + 1)
    ends = [stats.norm.ppf(stats.beta.ppf(q, rank, n + 1 - rank)) for q in (0.025, 0.975)]
    return {
        "quantile": stats.norm.ppf((rank - 0.5) / n).round(4).tolist(),
        "low": ends[0].round(4).tolist(),
        "high": ends[1].round(4).tolist(),
        "white": every.round(4).tolist(),
        "correlation": correlation([w for _, w in pieces]),
        "cross": {
            title: cross_correlation([(w, make(own)[order]) for own, w, order in ordered])
            for title, make in _MOTION.items()
        },
        "band": _SIDE / np.sqrt(n),
        **spectrum(pieces),
    }


def _white(own: Residuals, name: str, place: int) -> Array | None:
    """Return a row of the whitened residual of a recording; those of the error table stand by themselves."""
    row = CHANNELS[name].rows[place]
    if row in own.whitened and row in LISTED:
        return np.asarray(own.whitened[row][0])
    return _side(own.whitened[name][0], place) if name in own.whitened else None


def correlation(pieces: Sequence[Array]) -> list[float]:
    """Return the autocorrelation of values in successive windows, for lags of 1, 2, ... windows."""
    square = sum(float(own @ own) for own in pieces)
    lags = range(1, min(_LAGS, max(map(len, pieces)) - 1) + 1)
    return [
        round(sum(float(own[lag:] @ own[:-lag]) for own in pieces if len(own) > lag) / square, 4)
        for lag in lags
    ]


def cross_correlation(pieces: Sequence[tuple[Array, Array]]) -> list[float]:
    """Return the correlation of values with those of a motion, as many windows before them as the lag: −10 … 10.

    Zero where the motion is always the same.
    """
    mean = float(np.mean(np.concatenate([x for _, x in pieces])))
    size = np.sqrt(
        sum(float(w @ w) for w, _ in pieces) * sum(float((x - mean) @ (x - mean)) for _, x in pieces)
    )
    found = []
    for lag in range(-_REACH, _REACH + 1):
        total = 0.0
        for w, x in pieces:
            late, early = max(lag, 0), max(-lag, 0)
            if len(w) > late + early:
                total += float(w[late : len(w) - early] @ (x[early : len(x) - late] - mean))
        found.append(round(total / size, 4) if size > 0.0 else 0.0)
    return found


def spectrum(pieces: Sequence[tuple[Array, Array]]) -> dict[str, Any]:
    """Return the power of whitened values over frequency, 1 for noise, and the level that noise exceeds rarely.

    The windows lie unevenly in time, so this is a Lomb-Scargle periodogram, the mean of those of the recordings. In 95
    of 100 cases noise exceeds ``level`` at no frequency.
    """
    long = [(t, w) for t, w in pieces if len(w) >= _FEWEST and np.ptp(t) > 0.0]
    if not long:
        return {"frequency": [], "power": [], "level": 0.0}
    span, count = max((float(np.ptp(t)), len(t)) for t, _ in long)
    frequency = np.arange(1, max(count // 2, 1) + 1) / span
    power = np.mean([signal.lombscargle(t, w, 2.0 * np.pi * frequency) for t, w in long], axis=0)
    free = 2 * len(long)
    level = float(stats.chi2.ppf(0.95 ** (1.0 / len(frequency)), free)) / free
    return {"frequency": frequency.round(6).tolist(), "power": power.round(4).tolist(), "level": level}


def orders(session: Session, channel: str, chosen: Sequence[int]) -> dict[str, Any]:
    """Return the spectrum of the quantity of a channel over the order of the rotation, in some windows; empty: in all.

    ``lines`` are one or two spectra: title, amplitudes, and the level that noise seldom exceeds, in ``unit``.
    """
    found = session.step.comparison
    if found is None:
        raise InputError("orders: nothing is compared yet")
    if channel not in found.data.parts:
        raise InputError(f"channel: {channel[:60]!r} is not known; {nearest(channel, found.data.parts)}")
    count = len(found.data.windows)
    if not all(0 <= k < count for k in chosen):
        raise InputError(f"windows: must be of 0 .. {count - 1}")
    recordings = [own.data for own in session.used(ROLES[0])]
    kind = CHANNELS[channel]
    own = order_spectrum(
        recordings, found.data, kind.quantity, session.step.model.bench, list(chosen) or None
    )
    unit = unit_for(float(np.max(own.forward, initial=0.0)) or 1.0, kind.unit)
    name = f"{_SHOWN[kind.quantity]}, {unit.label}"
    kept = f"measured; residual at {', '.join(map(str, own.predicted))}" if own.predicted else "measured"
    lines = [(f"{name}: {kept}", own.forward, own.forward_level)]
    if len(own.backward):
        lines = [
            (f"{name}, with the rotor: {kept}", own.forward, own.forward_level),
            ("against the rotor: measured", own.backward, own.backward_level),
        ]
    return {
        "order": own.order.tolist(),
        "lines": [
            {"title": title, "amplitude": _rounded(values / unit.size), "level": _rounded(level / unit.size)}
            for title, values, level in lines
        ],
        "said": _orders_said(own, len(chosen), count, unit),
    }


def _rounded(values: Array) -> list[float]:
    return [float(f"{v:.5g}") for v in values]


def _orders_said(own: OrderSpectrum, chosen: int, count: int, unit: Unit) -> str:
    """Return what is drawn, and the lines that stand out, in sentences."""
    if not own.blocks:
        return f"Too few whole turns: a spectrum needs windows of {TURNS} turns without a missing sample."
    which = f"the {chosen} chosen windows" if chosen else f"all {count} windows"
    out = f", {own.left_out} left out (too short, or samples are missing)" if own.left_out else ""
    peaks = [
        (values[k] / level[k], f"{own.order[k]:g}{side}: {number(values[k] / unit.size, 3)} {unit.label}")
        for values, level, side in (
            (own.forward, own.forward_level, ""),
            (own.backward, own.backward_level, " against the rotor"),
        )
        for k in signal.find_peaks(np.r_[0.0, values, 0.0])[0] - 1
        if values[k] > level[k]
    ]
    clear = [said for _, said in sorted(peaks, reverse=True)[:_MOST_LINES]]
    lines = f"Above the level, clearest first: order {'; '.join(clear)}." if clear else "No order stands out."
    return (
        f"{lines} Dashed: the level that noise like that of the neighbouring orders exceeds in 5 of 100 spectra. "
        f"{own.blocks} blocks of {TURNS} turns in {which}{out}."
    )
