"""Checks of a torque table: its agreement with known properties of the flow, and of its rows with each other.

The limits come from `findings` and from the models; each names its derivation. Most findings hold for the published
rotor and case; a table of other lengths is checked only against the lines that do not depend on them.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import resources
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gyrowheel_air.cfd.case import Result
from gyrowheel_air.correlations import Correlation
from gyrowheel_air.geometry import Geometry
from gyrowheel_air.surrogate import REFERENCE_SPEED, fit_table
from gyrowheel_air.table import PROPORTION_LIMIT, WALL_FUNCTION_Y, TorqueTable
from gyrowheel_core.errors import InputError
from gyrowheel_core.schema import Name, Names, Number, Section, check
from gyrowheel_core.units import DEG, RPM
from gyrowheel_core.yaml_text import read_yaml


class _Entry(Section):
    """A finding as the file states it."""

    value: Number
    unit: Name
    uncertainty: Annotated[Number, Field(ge=0.0)]
    source: Name
    description: Name


class _File(Section):
    """A file of findings."""

    schema_: Literal[1] = Field(alias="schema")
    name: Name
    title: Name
    findings: Names[_Entry]


@dataclass(frozen=True)
class Finding:
    """A known number with its uncertainty."""

    #: Value and standard uncertainty, in its unit (SI).
    value: float
    uncertainty: float
    #: Unit, where both numbers come from, and what it is.
    unit: str
    source: str
    description: str

    def bar(self, times: float) -> tuple[float, float]:
        """Return the range within so many standard uncertainties."""
        return self.value - times * self.uncertainty, self.value + times * self.uncertainty


@functools.cache
def findings() -> dict[str, Finding]:
    """Return the findings by name."""
    origin = "findings.yaml"
    text = resources.files("gyrowheel_air").joinpath(origin).read_text(encoding="utf-8")
    content = check(_File, read_yaml(text, origin), origin, kind="file of findings")
    return {
        name: Finding(entry.value, entry.uncertainty, entry.unit, entry.source, entry.description)
        for name, entry in content.findings.items()
    }


Array = NDArray[np.float64]
_NAMES = ("T1", "T2", "T3")
_KINDS = ("restoring", "cross", "drag")
#: Standard uncertainties that a number may be off, and that each of many rows may be.
_ONE, _MANY = 2.0, 3.0
_OTHER = "not compared: a rotor and a case of other lengths"


@dataclass(frozen=True)
class Check:
    """One line of the check list."""

    what: str  # the criterion, in words, with its limits
    found: str  # value in the table
    holds: bool | None  # whether the criterion is met; None without a row for it
    bar: str  # source of the limits
    paper: str = ""  # statement of the published paper; empty without one
    cause: str = ""  # known cause in the flow


def check_table(table: TorqueTable) -> list[Check]:
    """Return the check list of a table."""
    published = Geometry.load().to_dict()
    geometry = Geometry.load()
    for name, value in table.lengths.items():
        geometry = geometry.with_value(name, value)
    of_the_rotor = [*_sizes(table), *_steps(table), *_two_states(table), *_tilt(table)]
    if any(abs(table.lengths[name] / value - 1.0) > PROPORTION_LIMIT for name, value in published.items()):
        of_the_rotor = [replace(line, holds=None, found=_OTHER) for line in of_the_rotor]
    return [
        *_symmetry(table),
        *_growth(table),
        *of_the_rotor,
        *_drag(table, geometry),
        *_rows_agree(table),
        *_quality(table),
    ]


def _symmetry(table: TorqueTable) -> Iterator[Check]:
    known = findings()["average_difference"]
    tilt, limit = table.tilts[-1], _ONE * known.uncertainty
    for words, direction, sign in (
        ("tilting backwards turns T1 and T2 round", 0.0, -1.0),
        ("tilting about an axis turned by 45° gives the same torques", 0.25 * np.pi, 1.0),
    ):
        what = f"{words}, within {_percent(limit)}"
        pairs = []
        for speed in table.speeds:
            row = table.find(sign * tilt, speed, direction=direction)
            base = table.at(tilt, speed)
            if row is not None and base is not None:
                pairs.append((row, base))
        if not pairs:
            yield Check(what, "no such row", None, known.source)
            continue
        flip = np.array([sign, sign, 1.0])
        off = np.array([row.torque.mean * flip / base.torque.mean - 1.0 for row, base in pairs])
        worst = off[np.argmax(np.abs(off), axis=0), range(3)]
        found = ", ".join(f"{name} {100 * value:+.1f} %" for name, value in zip(_NAMES, worst, strict=True))
        yield Check(what, f"{found} at {tilt / DEG:.3g}°", _all_within(off, -limit, limit), known.source)


def _growth(table: TorqueTable) -> Iterator[Check]:
    size, scatter = _sizes_of(table), _grid(table, "scatter")[1:]
    for i in (0, 1):
        clear = size[..., i] > 2.0 * scatter[..., i]
        yield Check(
            f"{_NAMES[i]} is not zero where the rotor is tilted",
            f"{int(clear.sum())} of {clear.size} rows beyond twice their scatter",
            bool(clear.all()),
            "twice the scatter of each row",
            "tilting about one axis gives both transverse torques",
        )
    grows = [np.diff(size[..., 0], axis=axis) > 0.0 for axis in (0, 1)]
    number, steps = sum(int(g.sum()) for g in grows), sum(g.size for g in grows)
    yield Check(
        "T1 grows with tilt and speed",
        f"{number} of {steps} steps grow",
        number == steps,
        "none: every step of the grid",
        "the transverse torques increase with tilt and speed",
    )


def _sizes(table: TorqueTable) -> Iterator[Check]:
    try:
        laws = fit_table(table).laws
    except InputError as error:
        yield Check("T1, T2 and T3 follow power laws of the speed", str(error), False, "")
        return
    unit = table.air.density * REFERENCE_SPEED**2 * table.lengths["rotor_radius"] ** 5
    for name, kind, law in zip(_NAMES, _KINDS, laws, strict=True):
        size, exponent = findings()[f"{kind}_size"], findings()[f"{kind}_exponent"]
        # the spread is the bar itself: a table that is further off is of another flow
        low, high = size.bar(1.0)
        what = f"{name} at 3500 rpm is {_span(low, high, 4)} of ρΩ²R⁵" + (
            "" if kind == "drag" else " tan(tilt)"
        )
        if law is None:
            yield Check(what, "no row with a tilt", None, size.source)
            continue
        yield Check(what, f"{law.size / unit:.4f}", low <= law.size / unit <= high, size.source)
        low, high = exponent.bar(_ONE)
        yield Check(
            f"{name} grows with the speed to the power of {_span(low, high, 2)}",
            f"{law.exponent:.3f} ± {law.exponent_error:.3f}; residuals {100 * law.rms:.1f} % rms, "
            f"{100 * law.largest:.1f} % at most",
            low <= law.exponent <= high,
            exponent.source,
            "it increases nonlinearly with the speed",
        )


def _steps(table: TorqueTable) -> Iterator[Check]:
    """Check every row against its neighbours in speed, where the flow keeps its state."""
    step = np.diff(np.log(table.speeds))
    kept = ~_in_two_states(table)[1:]
    for i, kind in ((0, "restoring"), (2, "drag")):
        known = findings()[f"{kind}_step"]
        sizes = -_grid(table, "mean")[(1 if i == 0 else 0) :, :, i]
        with np.errstate(divide="ignore", invalid="ignore"):
            exponents = np.diff(np.log(sizes), axis=1) / step
        chosen = exponents[kept[:, 1:]] if i == 0 else exponents.ravel()
        low, high = known.bar(_MANY)
        yield Check(
            f"{_NAMES[i]} from one speed to the next: power of {_span(low, high, 2)}"
            + (" outside of the two states" if i == 0 else ""),
            f"{chosen.min():.2f} .. {chosen.max():.2f} in {chosen.size} steps"
            if chosen.size
            else "one speed",
            _all_within(chosen, low, high) if chosen.size else None,
            known.source,
        )


def _two_states(table: TorqueTable) -> Iterator[Check]:
    known = findings()["two_states_fall"]
    tilt, speed = findings()["two_states_tilt"].value / DEG, findings()["two_states_speed"].value / RPM
    size = _sizes_of(table)[..., 1]
    inside = _in_two_states(table)[1:]
    ratios = [size[1:] / size[:-1], size[:, 1:] / size[:, :-1]]
    there = [inside[1:], inside[:, 1:]]
    falls = 1.0 - np.concatenate([r[t] for r, t in zip(ratios, there, strict=True)])
    grows = np.concatenate([r[~t] for r, t in zip(ratios, there, strict=True)]) > 1.0
    region = f"{tilt:.0f}° and more at {speed:.0f} rpm and more"
    cause = (
        "the vortices in the rim gap merge into fewer, and the flow goes over to a state with less of T1 and T2; "
        "a steady solution cannot say where a real rotor does"
    )
    statement = "the transverse torques increase with tilt and speed"
    yield Check(
        f"T2 grows with tilt and speed, but for {region}",
        f"{int(grows.sum())} of {grows.size} steps grow",
        bool(grows.all()),
        findings()["two_states_tilt"].source,
        statement,
    )
    limit = known.bar(_ONE)[1]
    worst = float(falls.max()) if falls.size else 0.0
    yield Check(
        f"T2 falls where the state changes ({region}), by {_percent(limit)} at most",
        f"{int(np.sum(falls > 0.0))} of {falls.size} steps fall, the most by {_percent(max(worst, 0.0))}",
        worst <= limit if falls.size else None,
        known.source,
        statement,
        cause,
    )


def _tilt(table: TorqueTable) -> Iterator[Check]:
    known = findings()["drag_fall"]
    drags = _grid(table, "mean")[..., 2]
    fall = 1.0 - drags[-1] / drags[0]
    low, high = known.bar(_ONE)
    yield Check(
        f"T3 falls by {_span(100 * low, 100 * high, 0)} % from no tilt to {table.tilts[-1] / DEG:.3g}°",
        f"{100 * fall.min():.1f} .. {100 * fall.max():.1f} %, most at {table.speeds[np.argmax(fall)] / RPM:.0f} rpm",
        _all_within(fall, low, high) if len(table.tilts) > 1 else None,
        known.source,
        "T3 hardly depends on the tilt",
        "the air that the tilt drives through the rim gap sweeps the Taylor vortices away, which carry much of "
        "the drag",
    )


def _drag(table: TorqueTable, geometry: Geometry) -> Iterator[Check]:
    model = Correlation(regime="II")
    fall = findings()["drag_fall"]
    for rows, less in (("without tilt", 0.0), (f"at {table.tilts[-1] / DEG:.3g}°", fall.value)):
        tilt = 0.0 if not less else float(table.tilts[-1])
        off, bars = {}, []
        for rpm in (1000.0, 3500.0):
            law = model.torque(geometry, table.air, (0.0, 0.0), rpm * RPM)
            bars.append(np.hypot(law.uncertainty[2] / -law.components[2], fall.uncertainty if less else 0.0))
            row = table.at(tilt, rpm * RPM)
            if row is not None:
                off[rpm] = row.torque.mean[2] / law.components[2] - 1.0 + less
        limit = float(min(bars))
        yield Check(
            f"T3 {rows} within {_percent(limit)} of disc II + Bilgen & Boulos"
            + (f" less {_percent(less)}" if less else "")
            + " at 1000 and 3500 rpm",
            ", ".join(f"{100 * value:+.1f} % at {rpm:.0f} rpm" for rpm, value in off.items())
            or "no such row",
            _all_within(np.array(list(off.values())), -limit, limit) if len(off) == 2 else None,
            "scatter of the measurements behind the correlations, spread of three cylinders"
            + (", and of the fall over the tilt" if less else ""),
        )


def _rows_agree(table: TorqueTable) -> Iterator[Check]:
    """Check the torque of every row against its pressure share and its wall stress."""
    mean, pressure = _grid(table, "mean"), _grid(table, "pressure")
    for i, kind in ((0, "restoring"), (1, "cross")):
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (pressure / mean)[1:, :, i]
        known = bool(np.any(pressure[1:, :, i]))
        yield _band(f"pressure's share of {_NAMES[i]}", share, findings()[f"{kind}_pressure"], told=known)
        if i == 1:
            own = share - np.median(share, axis=1, keepdims=True)
            name = "pressure's share of T2, compared with that of other speeds"
            yield _band(name, own, findings()["cross_pressure_step"], told=known)
    wall = np.array([[row.y_plus["rotor"][0] ** 2 for row in rows] for rows in _rows(table)])
    stress = mean[..., 2] / wall
    stress = stress / stress.mean()
    yield _band("T3 over the wall stress, over its mean", stress, findings()["drag_stress"])
    own = stress / np.median(stress, axis=1, keepdims=True) - 1.0
    yield _band(
        "T3 over the wall stress, compared with that of other speeds", own, findings()["drag_stress_step"]
    )


def _quality(table: TorqueTable) -> Iterator[Check]:
    rows = table.grid
    for name, words, bad in (
        ("unsettled", "still drift by more than 1 % of the torque", sum(not r.torque.settled for r in rows)),
        ("unsteady", "scatter by more than 2 % of the torque", sum(not r.torque.steady for r in rows)),
    ):
        known = findings()[name]
        most = int(known.bar(_ONE)[1] * len(rows))
        yield Check(
            f"{most} of {len(rows)} rows {words}, at most",
            f"{bad} of {len(rows)}",
            bad <= most,
            known.source,
            "",
            "with tilt the remains of the vortices wander: no steady state, given with its scatter"
            if bad
            else "",
        )
    averages = [r.y_plus["rotor"][0] for r in rows]
    largest = max(r.y_plus["rotor"][1] for r in rows)
    resolved = not rows[0].provenance["wall_functions"]
    low, high = (0.0, 2.0) if resolved else (WALL_FUNCTION_Y, 300.0)
    yield Check(
        f"y+ of the first cell on the rotor suits the model: {low:g} .. {high:g} on average",
        f"{min(averages):.2f} .. {max(averages):.2f} (largest anywhere {largest:.2f})",
        low <= min(averages) and max(averages) <= high,
        "wall layer resolved: viscous sublayer" if resolved else "range of the logarithmic law",
    )
    mesh, model = table.spread
    if np.any(mesh) or np.any(model):
        known = findings()["mesh_difference"]
        limit = known.bar(_ONE)[1]
        yield Check(
            f"T1, T2, T3 on another mesh with the same model within {_percent(limit)}",
            ", ".join(f"{name} {100 * value:.1f} %" for name, value in zip(_NAMES, mesh, strict=True)),
            _all_within(mesh, 0.0, limit) if np.any(mesh) else None,
            known.source,
            "the mesh is fine enough by T_dy without tilt, which symmetry makes zero on any mesh",
        )


def _band(name: str, values: Array, known: Finding, *, told: bool = True) -> Check:
    """Return the check of every row against a finding."""
    low, high = known.bar(_MANY)
    return Check(
        f"{name}: {_span(low, high, 3)}",
        f"{values.min():.3f} .. {values.max():.3f}" if told else "no row shows it",
        _all_within(values, low, high) if told else None,
        known.source,
    )


def _rows(table: TorqueTable) -> list[list[Result]]:
    found = [[table.at(tilt, speed) for speed in table.speeds] for tilt in table.tilts]
    return [[row for row in rows if row is not None] for rows in found]


def _grid(table: TorqueTable, quantity: str) -> Array:
    """Return a quantity of the torques of the grid, (tilts, speeds, 3)."""
    return np.array([[getattr(row.torque, quantity) for row in rows] for rows in _rows(table)])


def _sizes_of(table: TorqueTable) -> Array:
    """Return the torques of the tilted rows, multiplied by their expected signs."""
    return np.asarray(_grid(table, "mean")[1:] * [-1.0, 1.0, -1.0])


def _in_two_states(table: TorqueTable) -> NDArray[np.bool_]:
    """Return which rows of the grid (tilts, speeds) may be in either of the two states."""
    tilt, speed = findings()["two_states_tilt"].value, findings()["two_states_speed"].value
    return np.asarray((table.tilts[:, None] > tilt - 1e-6) & (table.speeds > speed - 1e-6))


def _all_within(values: Array, low: float, high: float) -> bool:
    return bool(np.all((values >= low) & (values <= high)))  # a NaN is not


def _percent(value: float) -> str:
    return f"{100 * value:.3g} %"


def _span(low: float, high: float, digits: int) -> str:
    return f"{low:.{digits}f} .. {high:.{digits}f}"
