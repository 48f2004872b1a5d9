"""The bench: every physical parameter with value, unit, standard uncertainty and source; bench files."""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Final

from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.files import is_file, read_text
from gyrowheel_core.schema import check, joined
from gyrowheel_core.units import conversion
from gyrowheel_sim.parameter import (
    INSTRUMENTS,
    SCHEMA,
    BenchFile,
    Gains,
    Parameter,
    SpinLoop,
    bench_content,
    check_value,
    default_text,
    description_of,
    read_parameters,
    unknown,
)

#: Files of the benches that come with the project, by name.
_SHIPPED = {"gyrowheel": "bench.yaml", "dtg": "dtg.yaml"}


def precession_inertia(value: Callable[[str], float]) -> float:
    """Return `Bench.precession_inertia` [kg m^2] for the parameters that `value` gives by name."""
    return value("rotor_inertia_z") + 0.5 * (value("gimbal_inertia_x") + value("gimbal_inertia_y"))


def axial_inertia(value: Callable[[str], float]) -> float:
    """Return `Bench.axial_inertia` [kg m^2] for the parameters that `value` gives by name."""
    return value("rotor_inertia_z") + value("gimbal_inertia_z") + value("shaft_inertia")


@dataclass(frozen=True)
class Bench:
    """Every physical parameter of a test bench; read from a bench file."""

    #: What the bench is called.
    name: str
    title: str
    parameters: Mapping[str, Parameter]  # the parameters by name
    #: Full citations by the key that `Parameter.source` starts with.
    references: Mapping[str, str] = field(default_factory=dict)
    origin: str = ""  # the file it was read from, for error messages
    #: How the motor's controller follows the wanted speed: ``pi``, proportional and integral in the speed, or
    #: ``pll``, phase-locked.
    spin_loop: SpinLoop = "pi"
    gains: Gains = field(default_factory=Gains)  # gains of the controller

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
            If the source is neither, or the file is missing, is no YAML, or a field of it is missing, unknown, out
            of range or in a unit of another kind.
        """
        if not isinstance(source, str | Path):
            raise InputError(
                f"bench: {type(source).__name__} is not allowed; allowed: the name of a shipped bench, or the path "
                "of a bench file"
            )
        if str(source) in _SHIPPED:
            name = _SHIPPED[str(source)]
            file = resources.files("gyrowheel_sim").joinpath(f"config/{name}")
            return cls.from_text(file.read_text(encoding="utf-8"), origin=name)
        path = Path(source)
        if not is_file(path):
            hint = nearest(str(source), _SHIPPED, "shipped")
            raise InputError(f"bench '{source}': no such shipped bench or file; {hint}")
        return cls.from_text(read_text(path, errors="replace"), origin=str(path))

    @staticmethod
    def shipped() -> list[str]:
        """Return the names of the benches that come with the project, the default one first."""
        return list(_SHIPPED)

    @classmethod
    def from_text(cls, text: str, *, origin: str) -> Bench:
        """Read a bench from the text of a bench file (see `load`)."""
        bench = cls._read(text, origin)
        # copies: a change of the mappings of one bench must not change another
        return replace(bench, parameters=dict(bench.parameters), references=dict(bench.references))

    @classmethod
    @functools.lru_cache(maxsize=32)  # a verb reads its bench many times
    def _read(cls, text: str, origin: str) -> Bench:
        raw = bench_content(text, origin)
        try:
            content = check(BenchFile, raw, origin, kind="bench file", every=True)
        except InputError as error:
            # the message lists unknown parameters with all other problems
            given = raw.get("parameters") if isinstance(raw, Mapping) else None
            names = unknown(given) if isinstance(given, Mapping) else []
            raise InputError(joined([str(error), *(f"parameters.{said}" for said in names)])) from None
        bench = cls(
            name=content.name,
            title=content.title,
            parameters=read_parameters(content.parameters, f"{origin}: parameters"),
            references=content.references,
            origin=origin,
            spin_loop=content.controller.spin_loop,
            gains=content.controller.gains,
        )
        if bench.value("spin_rate_minimum") >= bench.value("spin_rate_maximum"):
            raise InputError(f"{origin}: parameters.spin_rate_minimum: must be below spin_rate_maximum")
        return bench

    @property
    def stated(self) -> tuple[object, ...]:
        """Name, spin loop, gains and parameters: all of its file on which results depend."""
        return self.name, self.spin_loop, self.gains, *self.parameters.values()

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
                raise InputError(
                    f"{where}.{name}: the bench has no such parameter; {nearest(name, parameters)}"
                )
            parameters[name] = replace(parameters[name], value=check_value(name, value, where))
        return replace(self, parameters=parameters)

    @property
    def sample_period(self) -> float:
        """Sampling interval [s]."""
        return self.value("sample_period")

    @property
    def precession_inertia(self) -> float:
        """Angular momentum that a slow precession turns, over the spin rate: Irz + (Igx + Igy)/2 [kg m^2]."""
        return precession_inertia(self.value)

    @property
    def transverse_inertia(self) -> float:
        """Moment of inertia about an axis of the tilt: Irx + Igx/2 [kg m^2]."""
        return self.value("rotor_inertia_x") + 0.5 * self.value("gimbal_inertia_x")

    @property
    def flexure_stiffness(self) -> float:
        """Mean stiffness of both flexures [N m/rad]."""
        return 0.5 * (self.value("flexure_stiffness_x") + self.value("flexure_stiffness_y"))

    @property
    def axial_inertia(self) -> float:
        """Moment of inertia of everything that turns with the shaft [kg m^2]."""
        return axial_inertia(self.value)

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
        """Return the bench as JSON text, the provenance in a recording."""
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


#: Units in which people know the values of these parameters.
_SHOWN: Final = {
    "spin_rate_reference": "rpm",
    "spin_rate_minimum": "rpm",
    "spin_rate_maximum": "rpm",
    "tilt_reference": "deg",
    "tilt_limit": "deg",
}
_LINE: Final = re.compile(r"^  (?:# (?P<title>.*?)-*$|(?P<name>\w+): \{)")
_HEAD: Final = """\
# The bench {name}, begun as a copy of the bench {like}. docs/your_bench.md shows the way from here.
# Change every value that is another on your machine, with uncertainty and source; keep `assumed` where nobody knows.
#   value, unit    any unit of the kind: kg*m^2 or g*cm^2, rad/s or rpm, rad or deg, K or degC
#   uncertainty    standard uncertainty (1 sigma): in the unit of the value, or in per cent of it
#   source         where the value comes from: data sheet, drawing, measurement, or `assumed`
# `gyrowheel bench --bench FILE` shows it, and with --reach what it can reach; all errors are reported at once.
schema: 1
name: {name}
title: {title}
{references}
# Gains are rates, filters and shares of the bench's own momentum and inertia: these serve benches of any size.
controller:
  spin_loop: {spin_loop}  # pi, or pll: phase-locked
  # gains: {gains}
parameters:
"""


def bench_text(like: Bench, name: str) -> str:
    """Return the text of a bench file with the values of another bench.

    Parameters
    ----------
    like : Bench
        The bench to begin with.
    name : str
        Name of the new one.
    """
    gains = ", ".join(f"{key}: {value:g}" for key, value in asdict(like.gains).items())
    references = "".join(f"  {key}: {_quoted(text)}\n" for key, text in like.references.items())
    head = _HEAD.format(
        name=json.dumps(name) if not re.fullmatch(r"[A-Za-z]\w*", name) else name,
        like=like.name,
        title=_quoted(f"like {like.name}: {like.title}"),
        references=f"references:\n{references}".rstrip() if references else "",
        spin_loop=like.spin_loop,
        gains=f"{{{gains}}}",
    )
    return head + "\n".join(_lines(like)) + "\n"


def _lines(like: Bench) -> Iterator[str]:
    shared: dict[str, list[str]] = {}
    for p in like.parameters.values():
        shared.setdefault(p.group, []).append(p.name)
    for line in default_text().splitlines():
        found = _LINE.match(line)
        if found is None:
            continue
        if found["title"] is not None:
            title = found["title"].strip()
            yield f"\n  # ---- {title}"
            continue
        p = like.parameters[found["name"]]
        others = [name for name in shared[p.group] if name != p.name]
        along = f"; its uncertainty is common with {', '.join(others)}" if others else ""
        perfect = "; may be left out: perfect then" if p.name in INSTRUMENTS else ""
        yield f"  # {p.description}{along}{perfect}"
        yield f"  {p.name}: {_entry(p, like.name)}"


def _entry(p: Parameter, like: str) -> str:
    unit, value, size = p.unit, p.value, p.uncertainty
    if p.name in _SHOWN:
        unit = _SHOWN[p.name]
        _, factor = conversion(unit, p.unit)
        value, size = float(f"{value / factor:.12g}"), size / factor
    share = 100.0 * size / abs(value) if value else 0.0
    whole = share > 0.0 and math.isclose(float(f"{share:.3g}"), share, rel_tol=1e-9)
    spread = f"{share:.3g} %" if whole else f"{size:.6g}"
    source = p.source if p.source.startswith(("assumed", "as ")) else f"as {like}: {p.source}"
    shown = f'"{unit}"' if unit == "1" else unit
    parts = {"value": repr(value), "unit": shown, "uncertainty": spread, "source": _quoted(source)}
    if p.description != description_of(p.name):
        parts["description"] = _quoted(p.description)
    return f"{{{', '.join(f'{key}: {text}' for key, text in parts.items())}}}"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
