"""What may be missing in a model: an effect, or the error of a bench parameter."""

from __future__ import annotations

from dataclasses import dataclass

from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Effect, physical, registry
from gyrowheel_sim.effects.registry import for_bench

#: Bench parameters whose error is a finding of its own name: {finding: groups that move by one common factor}.
ERRORS: dict[str, tuple[str, ...]] = {
    "stiffness_error": ("flexure_stiffness_x", "flexure_stiffness_y"),
    "gimbal_inertia_error": ("gimbal_inertia",),
    "shaft_inertia_error": ("shaft_inertia",),
    "rotor_inertia_error": ("rotor_inertia_z",),
    "coil_gain_error": ("coil_constant",),
    "motor_constant_error": ("motor_constant",),
}


@dataclass(frozen=True)
class Term:
    """A term of a fit beside the nuisance parameters: an effect, or the error of a bench parameter."""

    name: str
    effect: Effect | None = None

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the free coefficients; the error of a parameter has one, its relative deviation."""
        return tuple(c.name for c in self.effect.coefficients) if self.effect else ("relative_error",)

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the coefficients for which zero means no effect."""
        return tuple(c.name for c in self.effect.amplitudes) if self.effect else ("relative_error",)


def parameter_errors(bench: Bench) -> list[str]:
    """Return the errors of bench parameters that can be a finding: a parameter stated as exact has none."""
    uncertain = bench.groups()
    return [name for name, groups in ERRORS.items() if all(group in uncertain for group in groups)]


def candidate_terms(bench: Bench) -> list[Term]:
    """Return every physical effect, as usual on a bench, and every parameter error that can be a finding."""
    effects = [Term(name, for_bench(effect, bench)) for name, effect in physical().items()]
    return effects + [Term(name) for name in parameter_errors(bench)]


def is_instrument(term: Term) -> bool:
    """Whether a term is an instrument that is not as stated."""
    return term.effect is not None and term.effect.category == "instrument"


def instrument_terms() -> list[Term]:
    """Return every instrument that may not be as stated; its size is the same on every bench."""
    return [Term(name, effect) for name, effect in registry().items() if is_instrument(Term(name, effect))]
