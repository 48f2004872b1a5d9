"""The bench: every physical parameter with value, unit, standard uncertainty and source."""

from __future__ import annotations

import difflib
import functools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import pint
import yaml

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.yaml_text import read_yaml

SCHEMA = 1
#: Files of the benches that come with the project, by name.
_SHIPPED = {"gyrowheel": "bench.yaml", "dtg": "dtg.yaml"}
#: Parameters that must be greater than zero for the equations to make sense.
_POSITIVE = frozenset(
    [
        "rotor_inertia_x",
        "rotor_inertia_y",
        "rotor_inertia_z",
        "shaft_inertia",
        "flexure_stiffness_x",
        "flexure_stiffness_y",
        "coil_constant",
        "coil_voltage_limit",
        "coil_resistance",
        "coil_heat_capacity",
        "coil_thermal_resistance",
        "motor_constant",
        "motor_resistance",
        "winding_heat_capacity",
        "winding_thermal_resistance",
        "motor_heat_capacity",
        "motor_thermal_resistance",
        "motor_ripple_order",
        "supply_voltage",
        "tilt_scale",
        "sample_period",
        "drift_time",
        "air_temperature",
        "air_density_reference",
        "gas_constant",
        "spin_rate_reference",
        "tilt_reference",
        "tilt_limit",
        "spin_rate_minimum",
        "spin_rate_maximum",
    ]
)
_NOT_NEGATIVE = frozenset(
    [
        "gimbal_inertia_x",
        "gimbal_inertia_y",
        "gimbal_inertia_z",
        "flexure_damping_x",
        "flexure_damping_y",
        "bearing_coulomb",
        "bearing_viscous",
        "tilt_noise",
        "spin_angle_noise",
        "spin_rate_noise",
        "coil_voltage_noise",
        "motor_voltage_noise",
        "motor_current_noise",
        "temperature_noise",
        "pressure_noise",
        "coil_voltage_drift",
        "motor_voltage_drift",
        "motor_current_drift",
        "air_pressure",
    ]
)


@functools.cache
def unit_registry() -> pint.UnitRegistry[Any]:
    """Return the one unit registry of the project."""
    return pint.UnitRegistry()


@dataclass(frozen=True)
class Parameter:
    """One physical parameter of a bench.

    Attributes
    ----------
    name : str
        Name, unique in the bench.
    value : float
        Value in `unit`.
    unit : str
        SI unit; a bench file may have any other of the same kind.
    uncertainty : float
        Standard uncertainty (1 sigma), absolute, in `unit`.
    source : str
        Where the value comes from; ``assumed`` where nothing published gives it.
    description : str
        What it is.
    group : str
        Parameters of one group vary by one common factor; the own name where there is no group. The analysis knows
        groups by name, so that those of the default bench hold for all.
    """

    name: str
    value: float
    unit: str
    uncertainty: float
    source: str
    description: str
    group: str

    @property
    def relative_uncertainty(self) -> float:
        """Standard uncertainty over the value (infinite for a value of zero with an uncertainty)."""
        if self.uncertainty == 0.0:
            return 0.0
        return abs(self.uncertainty / self.value) if self.value else math.inf


@dataclass(frozen=True)
class Bench:
    """Every physical parameter of a test bench; read from a bench file.

    Attributes
    ----------
    name, title : str
        What the bench is called.
    parameters : dict of str to Parameter
        The parameters by name.
    references : dict of str to str
        Full citations by the key that `Parameter.source` starts with.
    origin : str
        The file it was read from, for error messages.
    """

    name: str
    title: str
    parameters: Mapping[str, Parameter]
    references: Mapping[str, str] = field(default_factory=dict)
    origin: str = ""

    @classmethod
    def load(cls, source: str | Path = "gyrowheel") -> Bench:
        """Read a bench by shipped name or from a file.

        Parameters
        ----------
        source : str or Path
            A name of `shipped` (``"gyrowheel"`` is the default bench), or the path of a bench file.

        Raises
        ------
        InputError
            If the file is missing, is no YAML, or a field of it is missing, unknown, out of range or in a unit of
            another kind.
        """
        if str(source) in _SHIPPED:
            name = _SHIPPED[str(source)]
            file = resources.files("gyrowheel_sim").joinpath(f"config/{name}")
            return cls.from_text(file.read_text(encoding="utf-8"), origin=name)
        path = Path(source)
        if not path.is_file():
            near = difflib.get_close_matches(str(source), _SHIPPED, n=1)
            hint = f"; did you mean {near[0]}?" if near else f"; shipped: {', '.join(_SHIPPED)}"
            raise InputError(f"bench '{source}': no such shipped bench or file{hint}")
        return cls.from_text(path.read_text(encoding="utf-8", errors="replace"), origin=str(path))

    @staticmethod
    def shipped() -> list[str]:
        """Return the names of the benches that come with the project, the default one first."""
        return list(_SHIPPED)

    @classmethod
    def from_text(cls, text: str, *, origin: str) -> Bench:
        """Read a bench from the text of a bench file (see `load`)."""
        raw = read_yaml(text, origin)
        if not isinstance(raw, dict) or not isinstance(raw.get("parameters"), dict):
            raise InputError(f"{origin}: not a bench file (a mapping with 'parameters' is expected)")
        if raw.get("schema") != SCHEMA:
            raise InputError(f"{origin}: schema: {raw.get('schema')!r} is not known; allowed: {SCHEMA}")
        known = _defaults()
        parameters: dict[str, Parameter] = {}
        for name, entry in raw["parameters"].items():
            if known and name not in known:
                near = difflib.get_close_matches(str(name), known, n=1)
                hint = f"; did you mean '{near[0]}'?" if near else ""
                raise InputError(f"{origin}: parameters.{name}: no such parameter{hint}")
            parameters[name] = _parameter(str(name), entry, origin)
        missing = sorted(set(known) - set(parameters))
        if missing:
            raise InputError(f"{origin}: parameters: missing {', '.join(missing)}")
        bench = cls(
            name=str(raw.get("name", "bench")),
            title=str(raw.get("title", "")),
            parameters=parameters,
            references={str(k): str(v) for k, v in (raw.get("references") or {}).items()},
            origin=origin,
        )
        if bench.value("spin_rate_minimum") >= bench.value("spin_rate_maximum"):
            raise InputError(f"{origin}: parameters.spin_rate_minimum: must be below spin_rate_maximum")
        return bench

    def value(self, name: str) -> float:
        """Return the value of one parameter [SI]."""
        return self.parameters[name].value

    def values(self) -> dict[str, float]:
        """Return all values by name [SI]."""
        return {name: parameter.value for name, parameter in self.parameters.items()}

    def with_values(self, values: Mapping[str, float], *, where: str = "overrides") -> Bench:
        """Return the same bench with some values replaced.

        Raises
        ------
        InputError
            If a name is unknown or a value not allowed; `where` names the place in the message.
        """
        parameters = dict(self.parameters)
        for name, value in values.items():
            if name not in parameters:
                near = difflib.get_close_matches(name, parameters, n=1)
                hint = f"; did you mean '{near[0]}'?" if near else ""
                raise InputError(f"{where}.{name}: the bench has no such parameter{hint}")
            parameters[name] = replace(parameters[name], value=check_value(name, value, where))
        return replace(self, parameters=parameters)

    @property
    def sample_period(self) -> float:
        """Sampling interval [s]."""
        return self.value("sample_period")

    @property
    def precession_inertia(self) -> float:
        """Angular momentum that a slow precession turns, over the spin rate: Irz + (Igx + Igy)/2 [kg m^2]."""
        return self.value("rotor_inertia_z") + 0.5 * (
            self.value("gimbal_inertia_x") + self.value("gimbal_inertia_y")
        )

    @property
    def axial_inertia(self) -> float:
        """Moment of inertia of everything that turns with the shaft [kg m^2]."""
        return self.value("rotor_inertia_z") + self.value("gimbal_inertia_z") + self.value("shaft_inertia")

    @property
    def tuning_inertia(self) -> float:
        """Inertia A = Igx + Igy - Igz whose spin lowers the stiffness to K - A Omega^2 / 2 [kg m^2]."""
        return (
            self.value("gimbal_inertia_x") + self.value("gimbal_inertia_y") - self.value("gimbal_inertia_z")
        )

    def groups(self) -> dict[str, list[Parameter]]:
        """Return the uncertain parameters, those that vary together under one name."""
        groups: dict[str, list[Parameter]] = {}
        for parameter in self.parameters.values():
            if parameter.uncertainty > 0.0:
                groups.setdefault(parameter.group, []).append(parameter)
        return groups

    def describe(self) -> str:
        """Return the bench as JSON text: what a recording carries as its provenance."""
        return json.dumps(
            {
                "schema": SCHEMA,
                "name": self.name,
                "title": self.title,
                "parameters": {
                    p.name: {
                        "value": p.value,
                        "unit": p.unit,
                        "uncertainty": p.uncertainty,
                        "source": p.source,
                    }
                    for p in self.parameters.values()
                },
            },
            separators=(",", ":"),
        )


def check_value(name: str, value: Any, where: str) -> float:
    """Return `value` as a float allowed for parameter `name`; else raise InputError naming `where`."""
    number = _number(value, f"{where}.{name}")
    if name in _POSITIVE and number <= 0.0:
        raise InputError(f"{where}.{name}: {number:g} is out of range; allowed: > 0")
    if name in _NOT_NEGATIVE and number < 0.0:
        raise InputError(f"{where}.{name}: {number:g} is out of range; allowed: >= 0")
    return number


def _number(value: Any, where: str) -> float:
    """Return a finite number; else raise InputError naming `where`."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError(f"{where}: {value!r} is not a number")
    try:
        number = float(value)
    except (ValueError, OverflowError):
        raise InputError(f"{where}: {value!r} is not a number") from None
    if not math.isfinite(number):
        raise InputError(f"{where}: {value!r} is not finite")
    return number


def _conversion(unit: str, needed: str, where: str) -> tuple[float, float]:
    """Return offset and factor from `unit` to the unit `needed`; InputError naming `where` if there is no way."""
    if unit == needed:
        return 0.0, 1.0
    units = unit_registry()
    try:
        own, other = units.parse_units(unit), units.parse_units(needed)
    except Exception as error:  # pint raises several unrelated classes for a bad unit
        raise InputError(f"{where}: {unit!r} is no unit ({one_line(error)}); allowed: {needed}") from None
    # a frequency counts revolutions to people, but radians to the library of units
    names = {
        name
        for part in dict(units.Quantity(1.0, own).unit_items())
        for _, name, _ in units.parse_unit_name(part)
    }
    if own.dimensionality != other.dimensionality or "hertz" in names:
        raise InputError(f"{where}: {unit!r} cannot be converted; allowed: {needed} and its like")
    zero = float(units.Quantity(0.0, own).to(other).magnitude)
    return zero, float(units.Quantity(1.0, own).to(other).magnitude) - zero


@functools.cache
def _defaults() -> dict[str, tuple[str, str]]:
    """Return the SI unit and the group of every parameter, as the default bench has them."""
    text = resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text(encoding="utf-8")
    parameters = yaml.safe_load(text)["parameters"]
    return {name: (str(entry["unit"]), str(entry.get("group", name))) for name, entry in parameters.items()}


def _parameter(name: str, entry: Any, origin: str) -> Parameter:
    where = f"{origin}: parameters"
    if not isinstance(entry, dict):
        raise InputError(
            f"{where}.{name}: {entry!r} is not a mapping with value, unit, uncertainty and source"
        )
    unknown = set(entry) - {"value", "unit", "uncertainty", "source", "description", "group"}
    if unknown:
        raise InputError(f"{where}.{name}.{sorted(map(str, unknown))[0]}: no such field")
    for needed in ("value", "unit", "uncertainty", "source"):
        if needed not in entry:
            raise InputError(f"{where}.{name}.{needed}: missing")
    unit, own = _defaults()[name]
    offset, factor = _conversion(str(entry["unit"]), unit, f"{where}.{name}.unit")
    given = _number(entry["value"], f"{where}.{name}")
    value = check_value(name, factor * given + offset, where)
    raw = entry["uncertainty"]
    relative = isinstance(raw, str) and raw.strip().endswith("%")
    try:
        uncertainty = float(str(raw).strip().removesuffix("%")) * (abs(given) / 100.0 if relative else 1.0)
    except ValueError:
        raise InputError(
            f"{where}.{name}.uncertainty: {raw!r} is neither a number nor a percentage"
        ) from None
    uncertainty *= factor
    if not math.isfinite(uncertainty) or uncertainty < 0.0:
        raise InputError(f"{where}.{name}.uncertainty: {raw!r} is out of range; allowed: >= 0")
    group = str(entry.get("group", own))
    if group != own:
        # the analysis knows by these names which parameters err together
        allowed = "no group" if own == name else f"{own}"
        raise InputError(f"{where}.{name}.group: {group!r} is not its group; allowed: {allowed}")
    return Parameter(
        name=name,
        value=value,
        unit=unit,
        uncertainty=uncertainty,
        source=str(entry["source"]),
        description=str(entry.get("description", "")),
        group=group,
    )
