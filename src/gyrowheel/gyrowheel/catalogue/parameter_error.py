"""Errors of bench parameters that a diagnosis can report, next to effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gyrowheel_analysis.fitting.fit import ERRORS
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import registry
from gyrowheel_sim.parameter import Parameter


@dataclass(frozen=True)
class ParameterError:
    """An error of bench parameters that a diagnosis can report, which adds no law.

    `parameters`: the parameters, which differ from the bench file by a common factor; `look_alikes`: effects that
    look like it, and the test that separates them.
    """

    name: str
    parameters: Sequence[Parameter]
    look_alikes: Mapping[str, str]


def parameter_error(name: str, bench: Bench) -> ParameterError:
    """Return the error of bench parameters of a name that `ERRORS` has."""
    found = [p for p in bench.parameters.values() if p.group in ERRORS[name]]
    alike = {e.name: e.look_alikes[name] for e in registry().values() if name in e.look_alikes}
    return ParameterError(name, found, alike)
