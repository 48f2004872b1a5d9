"""Where a model fails: the regions that carry most of the misfit, and the variables on which the residual depends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit

from gyrowheel_analysis.balance import Balance
from gyrowheel_analysis.errors import channel_parts
from gyrowheel_analysis.reduction import Windows
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.units import DEG, RPM

Array = NDArray[np.float64]

_SHOWN = 5


@dataclass(frozen=True)
class Region:
    """A part of the data and its share of the misfit.

    Attributes
    ----------
    region : str
        Which part: channel, speed, kind of motion, air, coils.
    share_of_chi2 : float
        Its share of the sum of squares of the residuals in units of their noise.
    description : str
        What the residual looks like there.
    """

    region: str
    share_of_chi2: float
    description: str

    def to_json(self) -> dict[str, Any]:
        """Return the region as a JSON object."""
        return {"region": self.region, "share_of_chi2": self.share_of_chi2, "description": self.description}


@dataclass(frozen=True)
class TiltSpin:
    """Residuals of all windows, the tilt channels put together as complex numbers.

    Attributes
    ----------
    windows : Windows
        The windows of all recordings.
    tilt : complex ndarray (n,)
        Residual of the coil torque x + i y [N m].
    tilt_sigma : ndarray (n,)
        Its standard deviation, one axis [N m].
    spin, spin_sigma : ndarray (n,)
        Residual of the motor torque and its standard deviation [N m].
    """

    windows: Windows
    tilt: NDArray[np.complex128]
    tilt_sigma: Array
    spin: Array
    spin_sigma: Array


def tilt_and_spin(balances: Sequence[Balance], windows: Windows, rows: Array, deviation: Array) -> TiltSpin:
    """Put the residual rows of all recordings together."""

    def joined(values: Array, name: str) -> Array:
        return np.concatenate(channel_parts(balances, values, name))

    return TiltSpin(
        windows=windows,
        tilt=joined(rows, "tilt_x") + 1j * joined(rows, "tilt_y"),
        tilt_sigma=np.hypot(joined(deviation, "tilt_x"), joined(deviation, "tilt_y")) / math.sqrt(2.0),
        spin=joined(rows, "spin"),
        spin_sigma=joined(deviation, "spin"),
    )


def regions(data: TiltSpin, bench: Bench) -> list[Region]:
    """Return the few regions that carry most of the misfit, largest share first."""
    w = data.windows
    labels = _labels(w, bench)
    squares = {
        "tilt": np.abs(data.tilt) ** 2 / data.tilt_sigma**2,
        "spin": data.spin**2 / data.spin_sigma**2,
    }
    total = sum(float(v.sum()) for v in squares.values())
    found = []
    for channel, values in squares.items():
        for label in dict.fromkeys(labels):
            mask = np.array([own == label for own in labels])
            share = float(values[mask].sum()) / total if total else 0.0
            text = _describe_tilt(data, mask) if channel == "tilt" else _describe_spin(data, mask)
            found.append(Region(f"{channel}, {label}", share, text))
    found.sort(key=lambda region: -region.share_of_chi2)
    return found[:_SHOWN]


def _labels(w: Windows, bench: Bench) -> list[str]:
    name = [""] * len(w)
    for group in speed_groups(w.mean_spin):
        speed = float(np.median(w.mean_spin[group])) / RPM
        for index in group:
            name[index] = f"{round(speed / 10) * 10:.0f} rpm"
    ambient = bench.value("air_pressure")
    labels = []
    for index in range(len(w)):
        parts = [name[index]]
        if abs(w.mean_tilt_rate[index]) > 0.5 * DEG:
            parts.append("cone")
        if w.air_pressure[index] < 0.8 * ambient:
            parts.append("low pressure")
        if w.coil_temperature[index] - bench.value("air_temperature") > 8.0:
            parts.append("warm coils")
        if w.up[index] < 0:
            parts.append("inverted")
        labels.append(", ".join(parts))
    return labels


def _describe_tilt(data: TiltSpin, mask: NDArray[np.bool_]) -> str:
    r, z = data.tilt[mask], data.windows.mean_tilt[mask]
    rms = float(np.sqrt(np.mean(np.abs(r) ** 2))) * 1e3
    noise = float(np.sqrt(np.mean(data.tilt_sigma[mask] ** 2))) * 1e3
    text = f"coil torque beyond the model {rms:.2g} mN·m rms, noise {noise:.2g}"
    if len(r) >= 2 and float(np.abs(z).max()) > 0.5 * DEG:
        # a constant and a part that turns with the tilt
        design = np.column_stack([np.ones(len(z)), z])
        (constant, slope), *_ = np.linalg.lstsq(design, r, rcond=None)
        left = r - design @ np.array([constant, slope])
        part = abs(slope) ** 2 * float(np.var(z))
        if part > 0.5 * float(np.mean(np.abs(r) ** 2)):
            text += f"; turns with the tilt, {_phase(slope)}"
        elif abs(constant) ** 2 > 0.5 * float(np.mean(np.abs(r) ** 2)):
            text += f"; constant, {constant.real * 1e3:+.2g} about x and {constant.imag * 1e3:+.2g} about y"
        elif float(np.mean(np.abs(left) ** 2)) > 0.5 * float(np.mean(np.abs(r) ** 2)):
            text += "; neither constant nor in proportion to the tilt"
    return text


def _phase(slope: complex) -> str:
    angle = math.degrees(math.atan2(slope.imag, slope.real))
    if abs(angle) < 20.0:
        return "in phase with it"
    if abs(abs(angle) - 180.0) < 20.0:
        return "against it"
    side = "ahead of" if angle > 0 else "behind"
    return f"{abs(angle):.0f}° {side} it"


def _describe_spin(data: TiltSpin, mask: NDArray[np.bool_]) -> str:
    r = data.spin[mask]
    weight = 1.0 / data.spin_sigma[mask] ** 2
    mean = float(np.sum(weight * r) / np.sum(weight)) * 1e3
    noise = 1e3 * math.sqrt(len(r) / float(np.sum(weight)))
    side = "more" if mean > 0 else "less"
    return f"motor torque {abs(mean):.2g} mN·m {side} than the model, noise {noise:.2g}"


def dependence(data: TiltSpin) -> list[str]:
    """Return sentences that say on which variable the residual depends, channel by channel."""
    w = data.windows
    sentences = []
    variables = {
        "spin rate": w.mean_spin,
        "size of the tilt": np.abs(w.mean_tilt),
        "coil temperature": w.coil_temperature,
        "air pressure": w.air_pressure,
        "time": w.middle,
    }
    tilted = np.abs(w.mean_tilt) > 0.5 * DEG
    unit = np.where(tilted, w.mean_tilt / np.maximum(np.abs(w.mean_tilt), 1e-9), 1.0)
    turned = data.tilt * np.conj(unit)
    parts = {
        "tilt residual in phase with the tilt": (turned.real, tilted, data.tilt_sigma),
        "tilt residual across the tilt": (turned.imag, tilted, data.tilt_sigma),
        "spin residual": (data.spin, np.ones(len(w), dtype=bool), data.spin_sigma),
    }
    for name, (values, mask, sigma) in parts.items():
        # windows far noisier than the others (short ones) would drown what they show
        mask = mask & (sigma < 3.0 * float(np.median(sigma)))
        own = values[mask]
        if len(own) < 8 or float(np.mean(own**2)) < 2.0 * float(np.mean(sigma[mask] ** 2)):
            continue
        shares = {v: _explained(own, np.asarray(x)[mask]) for v, x in variables.items()}
        best = max(shares, key=lambda v: shares[v])
        if shares[best] > 0.3:
            others = ", ".join(f"{v} {shares[v]:.0%}" for v in shares if v != best)
            sentences.append(f"{name}: {shares[best]:.0%} of its variance follows the {best} ({others})")
        elif float(np.mean(own)) ** 2 > 0.5 * float(np.mean(own**2)):
            sentences.append(f"{name}: the same everywhere, {float(np.mean(own)) * 1e3:+.2g} mN·m")
    return sentences


def _explained(values: Array, variable: Array) -> float:
    spread = float(np.ptp(variable))
    if spread <= 1e-3 * max(abs(float(np.mean(variable))), 1e-12) or float(np.var(values)) == 0.0:
        return 0.0
    x = (variable - variable.min()) / spread
    design = np.vander(x, 3)
    fitted = design @ np.linalg.lstsq(design, values, rcond=None)[0]
    # adjusted for the three terms, so that pure noise is credited with nothing
    share = 1.0 - float(np.sum((values - fitted) ** 2)) / (len(values) - 3) / (
        float(np.var(values)) * len(values) / (len(values) - 1)
    )
    return max(share, 0.0)


def growth(data: TiltSpin) -> list[str]:
    """Return how the residual stands to the tilt and how it grows with the speed, as sentences.

    Only what describes most of the residual is said.
    """
    w = data.windows
    sentences = []
    weight = 1.0 / data.tilt_sigma**2
    z, r = w.mean_tilt, data.tilt
    # two descriptions of the tilt residual, each with its own size at every speed
    speeds = speed_groups(w.mean_spin)
    total = float(np.sum(weight * np.abs(r) ** 2))
    slopes, constants, left = [], [], {"turns": total, "constant": total}
    for index in speeds:
        g = weight[index]
        turning, still = float(np.sum(g * np.abs(z[index]) ** 2)), float(np.sum(g))
        slope = complex(np.sum(g * r[index] * np.conj(z[index])) / turning) if turning > 0.0 else 0.0j
        constant = complex(np.sum(g * r[index]) / still)
        left["turns"] -= abs(slope) ** 2 * turning
        left["constant"] -= abs(constant) ** 2 * still
        slopes.append((float(np.mean(w.mean_spin[index])), slope, turning))
        constants.append((float(np.mean(w.mean_spin[index])), constant, still))
    best = min(left, key=lambda name: left[name])
    if left[best] < 0.5 * total and total > 4.0 * len(r):
        if best == "turns":
            mean = sum(slope * g for _, slope, g in slopes) / sum(g for _, _, g in slopes)
            text = "the coils give a torque beyond the model's that turns with the tilt, "
            text += f"{_phase(mean)}, {abs(mean) * 1e3:.2g} mN·m/rad on average"
            known = [
                (speed, (slope * np.conj(mean)).real / abs(mean), g) for speed, slope, g in slopes if g > 0.0
            ]
            text += _growing(known)
        else:
            low, high = constants[0], constants[-1]
            text = "the coils give a torque beyond the model's that is the same at every tilt: "
            text += f"{_components(low[1])} at {low[0] / RPM:.0f} rpm"
            if len(constants) > 1:
                text += f", {_components(high[1])} at {high[0] / RPM:.0f} rpm"
        sentences.append(text)
    g = 1.0 / data.spin_sigma**2
    total = float(np.sum(g * data.spin**2))
    sizes = [
        (
            float(np.mean(w.mean_spin[i])),
            float(np.sum(g[i] * data.spin[i]) / np.sum(g[i])),
            float(np.sum(g[i])),
        )
        for i in speeds
    ]
    explained = sum(size**2 * weight for _, size, weight in sizes)
    if explained > 0.5 * total and total > 4.0 * len(data.spin):
        mean = float(np.sum(g * data.spin) / np.sum(g))
        side = "more" if mean > 0 else "less"
        text = f"the motor gives {abs(mean) * 1e3:.2g} mN·m {side} than the model asks for"
        text += _growing([(speed, size * math.copysign(1.0, mean), weight) for speed, size, weight in sizes])
        sentences.append(text)
    return sentences


def speed_groups(spin: Array) -> list[NDArray[np.int64]]:
    """Return the windows of every speed, slowest first; speeds within 4 % are one."""
    groups: list[list[int]] = []
    for index in np.argsort(spin):
        if groups and spin[index] <= 1.04 * spin[groups[-1][0]]:
            groups[-1].append(int(index))
        else:
            groups.append([int(index)])
    return [np.array(group) for group in groups]


def _components(torque: complex) -> str:
    return f"{torque.real * 1e3:+.2g} mN·m about x and {torque.imag * 1e3:+.2g} about y"


def _growing(sizes: Sequence[tuple[float, float, float]]) -> str:
    speed, size, weight = (np.array(column) for column in zip(*sizes, strict=True))
    exponent = _exponent(speed, size, weight) if len(speed) > 2 else None
    if exponent is None:
        return ""
    digits = 1 if exponent[1] >= 0.1 else 2
    return f", and grows as speed^{exponent[0]:.{digits}f}±{max(exponent[1], 0.01):.{digits}f}"


def _exponent(speed: Array, size: Array, weight: Array) -> tuple[float, float] | None:
    """Return exponent and its error of a power law of the speed; None where it cannot be told."""
    if float(speed.max() / speed.min()) < 1.3:
        return None
    reference = float(np.median(speed))

    def law(x: Array, amplitude: float, n: float) -> Array:
        return amplitude * (x / reference) ** n

    try:
        (_, n), covariance = curve_fit(
            law, speed, size, p0=(float(np.median(size)), 1.0), sigma=1.0 / np.sqrt(weight), maxfev=2000
        )
    except RuntimeError:
        return None
    error = float(np.sqrt(covariance[1, 1]))
    return (float(n), error) if error < 0.7 and abs(n) < 6.0 else None
