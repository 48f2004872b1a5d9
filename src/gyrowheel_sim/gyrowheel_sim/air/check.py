"""What a torque table must reproduce: symmetry, growth with tilt and speed, exponents, agreement with correlations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.air.cfd.case import Result
from gyrowheel_sim.air.correlations import drag
from gyrowheel_sim.air.geometry import Geometry
from gyrowheel_sim.air.surrogate import fit_table
from gyrowheel_sim.air.table import WALL_FUNCTION_Y, TorqueTable

Array = NDArray[np.float64]
_NAMES = ("T1", "T2", "T3")


@dataclass(frozen=True)
class Check:
    """One thing that a table must reproduce.

    Attributes
    ----------
    what : str
        What must hold, in words.
    found : str
        What the table has.
    holds : bool or None
        Whether it does; None where the table has no row for it.
    """

    what: str
    found: str
    holds: bool | None


def check_table(table: TorqueTable, geometry: Geometry | None = None) -> list[Check]:
    """Return the check list of a table.

    Parameters
    ----------
    table : TorqueTable
        What is checked.
    geometry : Geometry, optional
        Rotor and case for the correlations; by default of the table's own lengths.
    """
    if geometry is None:
        geometry = Geometry.load()
        for name, value in table.lengths.items():
            geometry = geometry.with_value(name, value)
    return [*_symmetry(table), *_tilt(table), *_exponents(table), *_drag(table, geometry), *_quality(table)]


def _symmetry(table: TorqueTable) -> Iterator[Check]:
    tilt = table.tilts[-1]
    for what, limit, direction, sign in (
        ("tilting backwards turns T1 and T2 round, within 5 %", 0.05, 0.0, -1.0),
        ("tilting about an axis turned by 45° gives the same torques, within 3 %", 0.03, 0.25 * np.pi, 1.0),
    ):
        pairs = []
        for speed in table.speeds:
            row = table.find(sign * tilt, speed, direction=direction)
            base = table.at(tilt, speed)
            if row is not None and base is not None:
                pairs.append((row, base))
        if not pairs:
            yield Check(what, "no such row", None)
            continue
        flip = np.array([sign, sign, 1.0])
        off = np.array([row.torque.mean * flip / base.torque.mean - 1.0 for row, base in pairs])
        # how far both averages may be apart by the scatter alone
        noise = np.max([_relative_scatter(row) + _relative_scatter(base) for row, base in pairs], axis=0)
        worst = off[np.argmax(np.abs(off), axis=0), range(3)]
        found = ", ".join(f"{name} {100 * value:+.1f} %" for name, value in zip(_NAMES, worst, strict=True))
        found += f" (scatter of both {', '.join(f'{100 * value:.1f}' for value in noise)} %)"
        yield Check(what, f"{found} at {tilt / DEG:.3g}°", bool(np.all(np.abs(off) <= limit)))


def _tilt(table: TorqueTable) -> Iterator[Check]:
    mean = _means(table)
    drags = mean[..., 2]
    ranges = np.ptp(drags, axis=0) / np.abs(drags.mean(axis=0))
    worst = int(np.argmax(ranges))
    yield Check(
        f"T3 varies by less than 10 % over 0 .. {table.tilts[-1] / DEG:.3g}°",
        f"{100 * ranges.min():.1f} .. {100 * ranges[worst]:.1f} %, most at {table.speeds[worst] / RPM:.0f} rpm",
        bool(np.all(ranges < 0.10)),
    )
    tilted = mean[table.tilts > 0.0]
    scatter = np.array(
        [[row.torque.scatter for row in _row(table, tilt)] for tilt in table.tilts[table.tilts > 0.0]]
    )
    for i, wanted in ((0, -1.0), (1, 1.0)):
        size = wanted * tilted[..., i]
        clear = size > 2.0 * scatter[..., i]
        grows = [np.diff(size, axis=axis) > 0.0 for axis in (0, 1)]
        steps = sum(g.size for g in grows)
        bad = steps - sum(int(g.sum()) for g in grows)
        yield Check(
            f"{_NAMES[i]} is not zero and grows with tilt and speed",
            f"{int(clear.sum())} of {clear.size} beyond twice their scatter; {steps - bad} of {steps} steps grow",
            bool(clear.all() and bad == 0),
        )


def _exponents(table: TorqueTable) -> Iterator[Check]:
    try:
        laws = fit_table(table).laws
    except InputError as error:
        yield Check("T1, T2 and T3 follow power laws of the speed", str(error), False)
        return
    for name, law, low, high in zip(_NAMES, laws, (1.8, 1.8, 1.4), (2.2, 2.2, 1.6), strict=True):
        what = f"{name} grows with the speed to the power of {low} .. {high}"
        if law is None:
            yield Check(what, "no row with a tilt", None)
        else:
            found = (
                f"{law.exponent:.3f} ± {law.exponent_error:.3f}; residuals {100 * law.rms:.1f} % rms, "
                f"{100 * law.largest:.1f} % at most"
            )
            yield Check(what, found, low <= law.exponent <= high)


def _drag(table: TorqueTable, geometry: Geometry) -> Iterator[Check]:
    places = (("without tilt", table.tilts[:1]), ("at all tilts", table.tilts))
    for place, tilts in places:
        what = f"T3 {place} within 15 % of disc II + Bilgen & Boulos at 1000 and 3500 rpm"
        off = {}
        for rpm in (1000.0, 3500.0):
            expected = drag(geometry, table.air, rpm * RPM, regime="II").total
            rows = [table.at(tilt, rpm * RPM) for tilt in tilts]
            ratios = [-row.torque.mean[2] / expected - 1.0 for row in rows if row is not None]
            if ratios:
                off[rpm] = max(ratios, key=abs)
        found = ", ".join(f"{100 * value:+.1f} % at {rpm:.0f} rpm" for rpm, value in off.items())
        holds = all(abs(value) <= 0.15 for value in off.values()) if len(off) == 2 else None
        yield Check(what, found or "no such row", holds)


def _quality(table: TorqueTable) -> Iterator[Check]:
    rows = table.grid
    settled = sum(r.torque.settled for r in rows)
    steady = sum(r.torque.steady for r in rows)
    yield Check(
        "every row of the grid has settled (means of both halves within 1 %) and is steady (scatter within 2 %)",
        f"{settled} of {len(rows)} settled, {steady} steady",
        settled == steady == len(rows),
    )
    averages = [r.y_plus["rotor"][0] for r in rows]
    largest = max(r.y_plus["rotor"][1] for r in rows)
    resolved = not rows[0].provenance["wall_functions"]
    low, high = (0.0, 2.0) if resolved else (WALL_FUNCTION_Y, 300.0)
    yield Check(
        f"y+ of the first cell on the rotor suits the model: {low:g} .. {high:g} on average",
        f"{min(averages):.2f} .. {max(averages):.2f} (largest anywhere {largest:.2f})",
        low <= min(averages) and max(averages) <= high,
    )
    mesh, model = table.spread
    if np.any(mesh) or np.any(model):
        yield Check(
            "mesh: T1, T2, T3 on another mesh with the same model within 5 %",
            ", ".join(f"{name} {100 * value:.1f} %" for name, value in zip(_NAMES, mesh, strict=True)),
            bool(np.all(mesh <= 0.05)) if np.any(mesh) else None,
        )


def _row(table: TorqueTable, tilt: float) -> list[Result]:
    rows = [table.at(tilt, speed) for speed in table.speeds]
    return [row for row in rows if row is not None]


def _means(table: TorqueTable) -> Array:
    return np.array([[row.torque.mean for row in _row(table, tilt)] for tilt in table.tilts])


def _relative_scatter(row: Result) -> Array:
    return np.asarray(row.torque.scatter / np.abs(row.torque.mean))
