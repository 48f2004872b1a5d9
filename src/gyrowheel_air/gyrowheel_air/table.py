"""The table of computed torques: rows with provenance, and the model that interpolates them."""

from __future__ import annotations

import functools
import json
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrowheel_air.cfd.case import Case, Result
from gyrowheel_air.geometry import LENGTHS, Geometry
from gyrowheel_air.torque import (
    AirState,
    AirTorque,
    check_range,
    check_speed,
    reynolds_number,
    split_tilt,
    tilt_axes,
)
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import is_file, read_text, write_text
from gyrowheel_core.units import DEG, RPM

if TYPE_CHECKING:
    from scipy.interpolate import RegularGridInterpolator

Array = NDArray[np.float64]
SCHEMA = 1
#: Wall functions hold from this y+ on: below it the logarithmic law lies above the linear one.
WALL_FUNCTION_Y = 11.0
#: Proportions of rotor and case may differ from the table's by this before it is refused (relative, of every gap).
PROPORTION_LIMIT = 0.02
#: Standard uncertainty of the local exponent in Reynolds number beyond the table's range.
_EXPONENT_UNCERTAINTY = 0.1
#: Largest extrapolation beyond the table's Reynolds numbers (factor).
_REACH = 10.0


@dataclass(frozen=True)
class TorqueTable:
    """Computed torques over tilt and speed, for one rotor in one case."""

    #: All rows: the grid, and companions on other meshes, with other models, tilted elsewhere.
    rows: tuple[Result, ...]
    origin: str = "table"  # where it was read from, for messages

    @classmethod
    def load(cls, source: str | Path = "gyrowheel") -> TorqueTable:
        """Read a table by shipped name (``"gyrowheel"``) or from a file.

        Raises
        ------
        InputError
            If the file is missing or is no table, or its rows do not fill a grid.
        """
        if str(source) == "gyrowheel":
            return _shipped()
        path = Path(source)
        if not is_file(path):
            raise InputError(f"torque table '{source}': no such shipped table or file; shipped: gyrowheel")
        return cls.from_text(read_text(path, errors="replace"), origin=str(path))

    @classmethod
    def from_text(cls, text: str, *, origin: str) -> TorqueTable:
        """Read a table from the text of a file (see `load`)."""
        try:
            raw = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{origin}: not valid JSON: {error}") from None
        if not isinstance(raw, dict) or not isinstance(raw.get("rows"), list):
            raise InputError(f"{origin}: not a torque table (a mapping with 'rows' is expected)")
        if raw.get("schema") != SCHEMA:
            raise InputError(f"{origin}: schema: {raw.get('schema')!r} is not known; allowed: {SCHEMA}")
        rows = []
        for number, row in enumerate(raw["rows"]):
            try:
                rows.append(Result.from_json(row))
            except (KeyError, TypeError, ValueError, IndexError) as error:
                reason = f"{type(error).__name__}: {error}"
                raise InputError(
                    f"{origin}: rows[{number}]: not a row of a torque table ({reason})"
                ) from None
        return cls.of(rows, origin=origin)

    @classmethod
    def of(cls, rows: Iterable[Result], *, origin: str = "table") -> TorqueTable:
        """Return a table of rows.

        Raises
        ------
        InputError
            If there are none, they are of several geometries or airs, or those of the grid do not fill one.
        """
        table = cls(tuple(sorted(rows, key=_order)), origin)
        if not table.rows:
            raise InputError(f"{origin}: no finished cases")
        if len({(r.case.lengths, r.case.density, r.case.viscosity) for r in table.rows}) > 1:
            raise InputError(f"{origin}: cases of several geometries or states of the air; one is expected")
        for row in table.rows:
            if not (np.all(np.isfinite(row.torque.mean)) and np.all(np.isfinite(row.torque.scatter))):
                raise InputError(f"{origin}: case {row.case.name}: a torque is not finite")
        missing = [
            f"{tilt / DEG:.4g} deg {speed / RPM:.6g} rpm"
            for tilt in table.tilts
            for speed in table.speeds
            if table.at(tilt, speed) is None
        ]
        if missing:
            raise InputError(
                f"{origin}: the grid of {table.method[0]}, {table.method[1]} lacks {len(missing)} of "
                f"{len(table.tilts) * len(table.speeds)} cases: {', '.join(missing[:4])}"
                f"{', ...' if len(missing) > 4 else ''}"
            )
        return table

    def write(self, path: Path) -> None:
        """Write the table atomically: JSON, SI units, one row a line."""
        rows = ",\n".join(json.dumps(row.to_json(), ensure_ascii=False) for row in self.rows)
        write_text(path, f'{{"schema": {SCHEMA}, "rows": [\n{rows}\n]}}\n')

    @functools.cached_property
    def method(self) -> tuple[str, str]:
        """Mesh and turbulence model of the grid: those of most rows."""
        counted = Counter((r.case.mesh, r.case.model) for r in self.rows)
        return counted.most_common(1)[0][0]

    @functools.cached_property
    def grid(self) -> tuple[Result, ...]:
        """The rows that are interpolated: of the grid's mesh and model, tilted about x, not backwards."""
        return tuple(
            r
            for r in self.rows
            if (r.case.mesh, r.case.model) == self.method and r.case.direction == 0.0 and r.case.tilt >= 0.0
        )

    @functools.cached_property
    def tilts(self) -> Array:
        """Tilts of the grid [rad], rising from zero."""
        return np.unique([r.case.tilt for r in self.grid])

    @functools.cached_property
    def speeds(self) -> Array:
        """Spin rates of the grid [rad/s], rising."""
        return np.unique([r.case.spin_rate for r in self.grid])

    @property
    def air(self) -> AirState:
        """The air for which it was computed."""
        case = self.rows[0].case
        paper = AirState.paper()
        return AirState(paper.temperature, paper.pressure, case.density, case.viscosity)

    @property
    def lengths(self) -> dict[str, float]:
        """Lengths of rotor and case for which it was computed [m]."""
        return dict(zip(LENGTHS, self.rows[0].case.lengths, strict=True))

    def at(self, tilt: float, spin_rate: float) -> Result | None:
        """Return the row of the grid at a tilt [rad] and a spin rate [rad/s], or None."""
        for row in self.grid:
            if math.isclose(row.case.tilt, tilt, abs_tol=1e-9) and math.isclose(
                row.case.spin_rate, spin_rate
            ):
                return row
        return None

    def find(
        self,
        tilt: float,
        spin_rate: float,
        *,
        mesh: str | None = None,
        model: str | None = None,
        direction: float = 0.0,
    ) -> Result | None:
        """Return a row by its condition and method; mesh and model default to those of the grid."""
        wanted = (mesh or self.method[0], model or self.method[1])
        for row in self.rows:
            case = row.case
            if (
                (case.mesh, case.model) == wanted
                and math.isclose(case.tilt, tilt, abs_tol=1e-9)
                and math.isclose(case.spin_rate, spin_rate)
                and math.isclose(case.direction, direction, abs_tol=1e-9)
            ):
                return row
        return None

    def alternatives(self) -> list[tuple[Result, Result]]:
        """Return the rows on other meshes or with other models, each with the row of the grid at its place."""
        pairs = []
        for row in self.rows:
            case = row.case
            if (case.mesh, case.model) != self.method and case.direction == 0.0:
                base = self.at(case.tilt, case.spin_rate)
                if base is not None:
                    pairs.append((row, base))
        return pairs

    @functools.cached_property
    def spread(self) -> tuple[Array, Array]:
        """Relative spread of the components over meshes, and over models, shape (3,) each.

        Over meshes: root mean square difference of the rows with the grid's model on other meshes; over models: of
        all rows with other models, without wall functions in cells that are too thin for them (`WALL_FUNCTION_Y`).
        Both at the largest tilt that has any.
        """
        pairs = [(row, base) for row, base in self.alternatives() if base.case.tilt > 0.0]
        if not pairs:
            return np.zeros(3), np.zeros(3)
        largest = max(base.case.tilt for _, base in pairs)
        pairs = [pair for pair in pairs if pair[1].case.tilt == largest]

        def size(chosen: Sequence[tuple[Result, Result]]) -> Array:
            if not chosen:
                return np.zeros(3)
            ratio = [row.torque.mean / base.torque.mean - 1.0 for row, base in chosen]
            return np.asarray(np.sqrt(np.mean(np.square(ratio), axis=0)))

        same = [(row, base) for row, base in pairs if row.case.model == self.method[1]]
        other = [
            (row, base)
            for row, base in pairs
            if row.case.model != self.method[1]
            and (not row.provenance["wall_functions"] or row.y_plus["rotor"][0] >= WALL_FUNCTION_Y)
        ]
        return size(same), size(other)


@dataclass(frozen=True)
class Table:
    """Interpolates a `TorqueTable` in tilt and Reynolds number.

    In another air, or with a rotor and case of the same proportions, the torque follows by similarity:
    T = rho Omega^2 R^5 f(Re, tilt). Tilts and spin rates beyond the table's are refused. A thinner or denser air leads
    to Reynolds numbers beyond it; there the power law at its edge goes on, with an uncertainty that grows.
    """

    table: TorqueTable  # the rows

    def __post_init__(self) -> None:
        """Refuse a table that is too small to interpolate."""
        tilts, speeds = len(self.table.tilts), len(self.table.speeds)
        if min(tilts, speeds) < 2:
            raise InputError(
                f"{self.table.origin}: {tilts} tilts and {speeds} speeds; at least 2 of each are needed to interpolate"
            )

    @property
    def name(self) -> str:
        """Name of the model."""
        return "table"

    def torque(self, geometry: Geometry, air: AirState, tilt: ArrayLike, spin_rate: float) -> AirTorque:
        """Return the torque of the air (see `AirModel.torque`)."""
        check_speed(spin_rate)
        angle, direction = split_tilt(tilt)
        self._check(geometry, angle, spin_rate)
        low, high = self._log_re[[0, -1]]
        log_re = math.log(reynolds_number(air, geometry.rotor_radius, spin_rate))
        inside = min(max(log_re, low), high)
        beyond = log_re - inside
        if abs(beyond) > math.log(_REACH):
            raise InputError(
                f"air: a Reynolds number of {math.exp(log_re):.3g} is too far from those of the torque table, "
                f"{math.exp(low):.3g} .. {math.exp(high):.3g}; allowed: within a factor {_REACH:g}"
            )
        values = self._mean([[angle, inside]])[0]
        scatter = self._scatter([[angle, inside]])[0]
        if beyond:
            # the power law between the outermost speeds goes on
            step = self._log_re[1] - low if beyond < 0.0 else self._log_re[-2] - high
            with np.errstate(divide="ignore", invalid="ignore"):
                slope = np.log(self._mean([[angle, inside + step]])[0] / values) / step
            growth = np.exp(np.where(np.isfinite(slope), slope, 0.0) * beyond)
            values, scatter = values * growth, scatter * growth
        scale = air.density * spin_rate**2 * geometry.rotor_radius**5
        mesh, model = self.table.spread
        relative = np.sqrt(mesh**2 + model**2 + (_EXPONENT_UNCERTAINTY * beyond) ** 2)
        return AirTorque(
            scale * values, scale * np.hypot(scatter, relative * np.abs(values)), tilt_axes(angle, direction)
        )

    def _check(self, geometry: Geometry, angle: float, spin_rate: float) -> None:
        speeds = self.table.speeds
        check_range(angle, spin_rate, self.table.tilts[-1], (speeds[0], speeds[-1]), "torque table")
        theirs = self.table.lengths
        ours = geometry.to_dict()
        size = ours["rotor_radius"] / theirs["rotor_radius"]
        gaps = {
            "rotor_height": lambda lengths: lengths["rotor_height"],
            "rim gap": lambda lengths: lengths["case_radius"] - lengths["rotor_radius"],
            "end gap": lambda lengths: 0.5 * (lengths["case_height"] - lengths["rotor_height"]),
        }
        for name, of in gaps.items():
            ratio = of(ours) / (size * of(theirs))
            if abs(ratio - 1.0) > PROPORTION_LIMIT:
                raise InputError(
                    f"geometry: {name}: {1e3 * of(ours):.4g} mm is out of range; the torque table is of other "
                    f"proportions, for which it would be {1e3 * size * of(theirs):.4g} mm within "
                    f"{100 * PROPORTION_LIMIT:g} %; 'gyrowheel cfd sweep' computes another table"
                )

    @functools.cached_property
    def _log_re(self) -> Array:
        air, radius = self.table.air, self.table.lengths["rotor_radius"]
        return np.log([reynolds_number(air, radius, speed) for speed in self.table.speeds])

    @functools.cached_property
    def _mean(self) -> RegularGridInterpolator:
        return self._interpolator("mean", odd=True)

    @functools.cached_property
    def _scatter(self) -> RegularGridInterpolator:
        return self._interpolator("scatter", odd=False)

    def _interpolator(self, quantity: str, *, odd: bool) -> RegularGridInterpolator:
        from scipy.interpolate import RegularGridInterpolator  # takes long to load

        table = self.table
        size = table.air.density * table.lengths["rotor_radius"] ** 5
        values = np.array(
            [
                [getattr(_there(table, t, w).torque, quantity) / (size * w**2) for w in table.speeds]
                for t in table.tilts
            ]
        )
        # symmetry: transverse torques are odd in the tilt, the drag is even
        sign = np.array([-1.0, -1.0, 1.0]) if odd else np.ones(3)
        if odd and table.tilts[0] == 0.0:
            values[0, :, :2] = 0.0
        start = 1 if table.tilts[0] == 0.0 else 0
        tilts = np.concatenate([-table.tilts[: start - 1 if start else None : -1], table.tilts])
        both = np.concatenate([(sign * values)[: start - 1 if start else None : -1], values])
        few = min(both.shape[:2]) < 4
        # monotone cubics: rows have scatter, and a spline would overshoot it
        return RegularGridInterpolator((tilts, self._log_re), both, method="linear" if few else "pchip")


def _there(table: TorqueTable, tilt: float, spin_rate: float) -> Result:
    row = table.at(tilt, spin_rate)
    assert row is not None  # `TorqueTable.of` has made sure
    return row


def collect_results(folder: Path) -> list[Result]:
    """Read all finished cases below the folder of a study.

    Raises
    ------
    InputError
        If there is no such folder, or a result cannot be read.
    """
    from gyrowheel_air.cfd.case import RESULT

    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    results = []
    for path in sorted(folder.glob(f"*/{RESULT}")):
        try:
            results.append(Result.from_json(json.loads(path.read_text(encoding="utf-8"))))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not the result of a case ({type(error).__name__}: {error})") from None
    return results


@functools.cache
def _shipped() -> TorqueTable:
    file = resources.files("gyrowheel_air").joinpath("data/torques.json")
    return TorqueTable.from_text(file.read_text(encoding="utf-8"), origin="torques.json")


def _order(row: Result) -> tuple[Any, ...]:
    case: Case = row.case
    return (case.mesh, case.model, case.direction, case.tilt, case.spin_rate)
