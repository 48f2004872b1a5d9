"""Physical parameters and controller gains of a bench, and the bench file that states them."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from importlib import resources
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

from pydantic import Field, PlainValidator

from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.schema import Name, Names, Number, Section, finite, joined, refuse
from gyrowheel_core.units import conversion
from gyrowheel_core.yaml_text import read_yaml


@dataclass(frozen=True)
class Gains:
    """Gains of the loops.

    They are rates, filters and shares of the bench's own momentum and inertia, so that one set serves benches of any
    size. The defaults settle a 3 deg ramp at 8 deg/s to 0.015 deg within 0.5 s from 1000 to 4000 rpm on the default
    bench, where they are 0.12 N m s/rad, 0.012 N m s/rad and 0.02 N m/rad.
    """

    tilt_bandwidth: float = 12.0  # bandwidth of the tilt loop [1/s]
    tilt_integral: float = 30.0  # integral gain of the tilt loop [1/s^2]
    tilt_lowpass: float = 25.0  # low-pass of the tilt readings [Hz]
    nutation_damping: float = 0.1832  # gain of the nutation damper over the angular momentum of the spin
    derivative_lowpass: float = 400.0  # low-pass of its derivative [Hz]
    #: Gains of the spin loop over the moment of inertia of all that turns [1/s], [1/s^2]; of a phase-locked
    #: loop (`Bench.spin_loop`) on the rate of the phase between reference and shaft, and on the phase itself.
    #: Assumed: the publication names its loop and gives no gain.
    spin_proportional: float = 6.34
    spin_integral: float = 10.57
    spin_lowpass: float = 6.0  # low-pass of the spin reading, applied twice [Hz]

    def __post_init__(self) -> None:
        """Check every gain."""
        for item in fields(self):
            value = getattr(self, item.name)
            if not math.isfinite(value) or value < 0.0:
                raise InputError(f"gains.{item.name}: {value!r} is out of range; allowed: >= 0")


SCHEMA = 1
_CHANNELS = ("tilt", "coil_voltage", "motor_voltage", "motor_current")
#: Parameters of the instruments by the value that a perfect instrument has; a bench file may leave them out. They are
#: in the order in which a machine is drawn.
INSTRUMENTS: Mapping[str, float] = MappingProxyType(
    {
        "tilt_delay": 0.0,
        "spin_angle_delay": 0.0,
        **dict.fromkeys([f"{n}_delay" for n in _CHANNELS[1:]], 0.0),
        **dict.fromkeys([f"{n}_filter_time" for n in _CHANNELS], 0.0),
        **dict.fromkeys([f"{n}_filter_order" for n in _CHANNELS], 1.0),
        "encoder_zero": 0.0,
        **dict.fromkeys([f"encoder_{times}_{part}" for times in ("once", "twice") for part in "xy"], 0.0),
        "tilt_cubic": 0.0,
        "tilt_cross_talk": 0.0,
        **dict.fromkeys(
            [f"{n}_resolution" for n in ("tilt", "spin_angle", "spin_rate", *_CHANNELS[1:])], 0.0
        ),
        **dict.fromkeys([f"{n}_resolution" for n in ("temperature", "pressure")], 0.0),
        **dict.fromkeys([f"{n}_hum" for n in _CHANNELS], 0.0),
        "mains_frequency": 50.0,
        "clock_jitter": 0.0,
        "clock_rate_error": 0.0,
    }
)
#: Longest delay and slowest filter that are described [s]; beyond them, a reading belongs to another moment.
LONGEST_DELAY = 2.0e-3
SLOWEST_FILTER = 1.0e-2
HIGHEST_ORDER = 4
#: Kinds of the spin loop.
SpinLoop: TypeAlias = Literal["pi", "pll"]
#: Parameters that must be greater than zero for the equations to make sense.
_POSITIVE = frozenset([
    "rotor_inertia_x", "rotor_inertia_y", "rotor_inertia_z", "shaft_inertia", "flexure_stiffness_x",
    "flexure_stiffness_y", "coil_constant", "coil_voltage_limit", "coil_resistance", "coil_heat_capacity",
    "coil_thermal_resistance", "motor_constant", "motor_resistance", "winding_heat_capacity",
    "winding_thermal_resistance", "motor_heat_capacity", "motor_thermal_resistance", "motor_ripple_order",
    "supply_voltage", "tilt_scale", "sample_period", "drift_time", "air_temperature", "air_density_reference",
    "gas_constant", "spin_rate_reference", "tilt_reference", "tilt_limit", "mains_frequency",
    "spin_rate_minimum", "spin_rate_maximum",
])  # fmt: skip
_NOT_NEGATIVE = frozenset([
    "gimbal_inertia_x", "gimbal_inertia_y", "gimbal_inertia_z", "flexure_damping_x", "flexure_damping_y",
    "bearing_coulomb", "bearing_viscous", "tilt_noise", "spin_angle_noise", "spin_rate_noise",
    "coil_voltage_noise", "motor_voltage_noise", "motor_current_noise", "temperature_noise", "pressure_noise",
    "coil_voltage_drift", "motor_voltage_drift", "motor_current_drift", "air_pressure", "clock_jitter",
    *(name for name in INSTRUMENTS if name.endswith(("_filter_time", "_resolution", "_hum"))),
])  # fmt: skip


@dataclass(frozen=True)
class Parameter:
    """One physical parameter of a bench."""

    name: str  # name, unique in the bench
    value: float  # value in `unit`
    unit: str  # SI unit; a bench file may state any other unit of the same kind
    uncertainty: float  # standard uncertainty (1 sigma), absolute, in `unit`
    source: str  # source of the value; ``assumed`` where nothing is published
    description: str
    #: Parameters of one group vary by one common factor; without a group it is the parameter's own name. The
    #: analysis refers to groups by name, so every bench has those of the default bench.
    group: str

    @property
    def relative_uncertainty(self) -> float:
        """Standard uncertainty over the value (infinite for a value of zero with an uncertainty)."""
        if self.uncertainty == 0.0:
            return 0.0
        return abs(self.uncertainty / self.value) if self.value else math.inf


class Uncertainty(NamedTuple):
    """A standard uncertainty as stated by a file: in the unit of the value, or in per cent of it."""

    size: float
    relative: bool


def _uncertainty(raw: Any) -> Uncertainty:
    text = str(raw).strip()
    relative = text.endswith("%")
    try:
        size = math.nan if isinstance(raw, bool) else float(text.removesuffix("%"))
    except ValueError:
        size = math.nan
    if math.isnan(size):
        refuse(f"{raw!r} is neither a number nor a percentage")
    if not 0.0 <= size < math.inf:
        refuse(f"{raw!r} is out of range; allowed: >= 0")
    return Uncertainty(size, relative)


class ParameterEntry(Section):
    """A parameter as a bench file states it, in any unit of its kind."""

    value: Number
    unit: Name
    uncertainty: Annotated[Uncertainty, PlainValidator(_uncertainty)]
    source: Name
    description: Name = ""
    group: Name | None = None


def _gains(raw: Any) -> Gains:
    usual = Gains()
    if raw is None:
        return usual
    if not isinstance(raw, Mapping):
        refuse(f"{raw!r} is not a mapping")
    wrong, given = [], {}
    for key, value in raw.items():
        name = str(key)
        try:
            if not hasattr(usual, name):
                raise InputError(f"{name}: no such gain; {nearest(name, asdict(usual))}")
            given[name] = finite(value, name)
            replace(usual, **{name: given[name]})
        except InputError as error:
            wrong.append(str(error).removeprefix("gains."))
    if wrong:
        refuse(joined(wrong))
    return replace(usual, **given)


class ControllerEntry(Section):
    """The section ``controller`` of a bench file; gains that it does not state are the usual ones."""

    spin_loop: SpinLoop = "pi"
    gains: Annotated[Gains, PlainValidator(_gains)] = Gains()
    source: Name = "assumed"


class BenchFile(Section):
    """A bench file."""

    schema_: Literal[1] = Field(alias="schema")
    name: Name = "bench"
    title: Name = ""
    references: Names[Name] = Field(default_factory=dict)
    controller: ControllerEntry = Field(default_factory=ControllerEntry)
    parameters: dict[Name, ParameterEntry]


def default_text() -> str:
    """Return the text of the default bench file, which names every parameter, its SI unit and its group."""
    return resources.files("gyrowheel_sim").joinpath("config/bench.yaml").read_text(encoding="utf-8")


@functools.lru_cache(maxsize=4)
def bench_content(text: str, origin: str) -> Any:
    """Return the content of a bench file, cached: the default one also describes the parameters."""
    return read_yaml(text, origin)


@functools.cache
def _known() -> dict[str, tuple[str, str, str]]:
    """Return the SI unit, the group and the description of every parameter, as the default bench has them."""
    entries = bench_content(default_text(), "bench.yaml")["parameters"]
    return {
        name: (str(entry["unit"]), str(entry.get("group", name)), str(entry["description"]))
        for name, entry in entries.items()
    }


def description_of(name: str) -> str:
    """Return the default description of a parameter."""
    return _known()[name][2]


def unknown(names: Iterable[Any]) -> list[str]:
    """Return one message for each name that is no parameter, with the nearest valid name."""
    known = _known()
    return [f"{name}: no such parameter; {nearest(str(name), known)}" for name in names if name not in known]


def read_parameters(entries: Mapping[str, ParameterEntry], where: str) -> dict[str, Parameter]:
    """Return the parameters of a bench in SI units.

    `entries`: what the file states; `where`: file and field, for messages. Raises InputError if parameters
    other than those of instruments are missing, or some are unknown, have units of another kind, values out
    of range or groups that the analysis does not know; one message lists all problems.
    """
    known = _known()
    wrong = unknown(entries)
    stated = {}
    for name, entry in entries.items():
        try:
            if name in known:
                stated[name] = _parameter(name, entry)
        except InputError as error:
            wrong.append(str(error))
    if missing := sorted(known.keys() - entries.keys() - INSTRUMENTS.keys()):
        wrong.append(f"missing {', '.join(missing)}")
    if wrong:
        first = ": " if wrong[0].startswith("missing ") else "."
        raise InputError(f"{where}{first}{joined(wrong)}")
    return stated | {name: _perfect(name) for name in INSTRUMENTS if name not in stated}


def _perfect(name: str) -> Parameter:
    """Return a parameter of a perfect instrument, for a bench file that does not state it."""
    unit, group, description = _known()[name]
    return Parameter(
        name, INSTRUMENTS[name], unit, 0.0, "not stated: a perfect instrument", description, group
    )


def _parameter(name: str, entry: ParameterEntry) -> Parameter:
    unit, own, description = _known()[name]
    try:
        offset, factor = conversion(entry.unit, unit)
    except InputError as error:
        raise InputError(f"{name}.unit: {error}") from None
    value = check_value(name, factor * entry.value + offset)
    stated = entry.uncertainty
    group = own if entry.group is None else entry.group
    if group != own:
        # the analysis refers to the groups by these names
        allowed = "no group" if own == name else own
        raise InputError(f"{name}.group: {group!r} is not its group; allowed: {allowed}")
    return Parameter(
        name=name,
        value=value,
        unit=unit,
        uncertainty=stated.size * (abs(entry.value) / 100.0 if stated.relative else 1.0) * factor,
        source=entry.source,
        description=entry.description or description,
        group=group,
    )


def physical_range(name: str) -> tuple[float, float]:
    """Return the possible values of a parameter (low, high), infinite where there is no limit.

    A low of zero is itself impossible for some.
    """
    if name in INSTRUMENTS and name not in _NOT_NEGATIVE:
        if name.endswith("_delay"):
            return -LONGEST_DELAY, LONGEST_DELAY
        if name.endswith("_filter_order"):
            return 1, HIGHEST_ORDER
        if name == "clock_rate_error":
            return -0.1, 0.1
    high = SLOWEST_FILTER if name.endswith("_filter_time") else math.inf
    return (0.0 if name in _POSITIVE | _NOT_NEGATIVE else -math.inf, high)


def check_value(name: str, value: Any, where: str = "") -> float:
    """Return a value [SI] as a number that is allowed for the parameter `name`.

    Raises InputError if it is not; the message begins with `where`, if given, and the name.
    """
    place = f"{where}.{name}" if where else name
    number = finite(value, place)
    if name in _POSITIVE and number <= 0.0:
        raise InputError(f"{place}: {number:g} is out of range; allowed: > 0")
    if name in _NOT_NEGATIVE and number < 0.0:
        raise InputError(f"{place}: {number:g} is out of range; allowed: >= 0")
    if name in INSTRUMENTS:
        _check_instrument(name, number, place)
    return number


def _check_instrument(name: str, value: float, place: str) -> None:
    low, high = physical_range(name)
    if name.endswith("_filter_order") and value != round(value):
        raise InputError(f"{place}: {value:g} is out of range; allowed: 1, 2, 3 or 4")
    if not low <= value <= high:
        raise InputError(f"{place}: {value:g} is out of range; allowed: {low:g} .. {high:g}")
