"""The bench: every physical parameter with value, unit, standard uncertainty and source."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path

from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.files import is_file, read_text
from gyrowheel_core.schema import check, joined
from gyrowheel_sim.gains import Gains
from gyrowheel_sim.parameter import (
    SCHEMA,
    BenchFile,
    Parameter,
    SpinLoop,
    bench_content,
    check_value,
    read_parameters,
    unknown,
)

#: Files of the benches that come with the project, by name.
_SHIPPED = {"gyrowheel": "bench.yaml", "dtg": "dtg.yaml"}


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
    spin_loop : str
        How the motor's controller follows the wanted speed: ``pi``, proportional and integral in the speed, or ``pll``,
        phase-locked.
    gains : Gains
        Gains of the controller.
    origin : str
        The file it was read from, for error messages.
    """

    name: str
    title: str
    parameters: Mapping[str, Parameter]
    references: Mapping[str, str] = field(default_factory=dict)
    origin: str = ""
    spin_loop: SpinLoop = "pi"
    gains: Gains = field(default_factory=Gains)

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
        # of its own: who changes the mappings of one changes no other
        return replace(bench, parameters=dict(bench.parameters), references=dict(bench.references))

    @classmethod
    @functools.lru_cache(maxsize=32)  # a verb reads its bench many times
    def _read(cls, text: str, origin: str) -> Bench:
        raw = bench_content(text, origin)
        try:
            content = check(BenchFile, raw, origin, kind="bench file", every=True)
        except InputError as error:
            # names that are no parameters belong to what is told at once
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
