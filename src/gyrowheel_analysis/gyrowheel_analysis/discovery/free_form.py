"""Forms that no declaration contains: what an unknown effect might look like, offered as a formula.

The family: torques that turn with any multiple of the tilt's direction and grow with powers of tilt and speed, bumps
at one speed, dead zones in the tilt. It answers two questions: is there something that the registered effects do not
describe, and which formula describes it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import sympy as sp

from gyrowheel_analysis.discovery.fit import Fit, Problem, Term
from gyrowheel_analysis.discovery.selection import Progress, Selection, rank
from gyrowheel_sim.effects.declaration import Coefficient, Effect, Law, Target
from gyrowheel_sim.effects.quantities import Omega, Omega_ref, z, z_ref
from gyrowheel_sim.effects.sizes import for_bench

#: How much likelier (minus twice the log) a free form must make the recording before the library is doubted.
UNKNOWN = 30.0
_TRIED = 6

_a, _b, _p, _w = (sp.Symbol(name, real=True) for name in ("a", "b", "p", "w"))
_r = Omega / Omega_ref
_u = z / z_ref
_size = sp.sqrt(z * sp.conjugate(z)) / z_ref


@dataclass(frozen=True)
class Proposal:
    """A free form that describes what the library does not.

    Attributes
    ----------
    term : Term
        The form.
    fit : Fit
        The fit with it.
    gain : float
        How much likelier it makes the recording (minus twice the log of the likelihood).
    keeps : bool
        Whether the effects selected from the library stand beside it (else it stands in their place).
    """

    term: Term
    fit: Fit
    gain: float
    keeps: bool


def _amplitude(name: str, target: Target) -> Coefficient:
    size = (1.0e-4, 2.0e-3) if target == "rotor_torque" else (5.0e-5, 1.0e-3)
    return Coefficient(
        name, "N*m", "size at the reference tilt and speed", size, (-1.0, 1.0), "fitted", signed=True
    )


def _form(name: str, sentence: str, target: Target, shape: sp.Expr, *shapes: Coefficient) -> Term:
    law = (_a + sp.I * _b) * shape if target == "rotor_torque" else _a * shape
    amplitudes = [_amplitude("a", target)] + ([_amplitude("b", target)] if target == "rotor_torque" else [])
    name = name.replace(".", "_")
    effect = Effect(
        name=name,
        title="free form",
        category="other",
        sentence=sentence,
        laws=(Law(target, law),),
        coefficients=(*amplitudes, *shapes),
        validity="the range of the recording",
        source="proposed from the recording",
    )
    return Term(name, effect)


def _shape(name: str, value: float, spread: float, description: str) -> Coefficient:
    return Coefficient(
        name,
        "1",
        description,
        (value - spread, value + spread),
        (0.01, 3.0),
        "fitted",
        shape=value,
        shape_uncertainty=spread,
    )


@functools.cache
def forms() -> tuple[Term, ...]:
    """Return the family of free forms."""
    result = []
    for order in (-3, -2, -1, 0, 2, 3):
        direction = _u**order if order >= 0 else sp.conjugate(_u) ** (-order)
        for q in (0, 1, 2):
            powers = (abs(order),) if order else (2,)
            for k in powers:
                shape = direction * _size ** (k - abs(order)) * _r**q
                text = f"torque with {order} times the direction of the tilt, |tilt|^{k}, speed^{q}"
                result.append(_form(f"lobes_{order}_{k}_{q}".replace("-", "m"), text, "rotor_torque", shape))
    for k, q in ((1, 1), (1, 3), (1, 4), (2, 0), (2, 1), (2, 2), (4, 0), (5, 0), (5, 2)):
        text = f"torque along the tilt, |tilt|^{k}, speed^{q}"
        result.append(_form(f"power_{k}_{q}", text, "rotor_torque", _u * _size ** (k - 1) * _r**q))
    for centre in (0.3, 0.37, 0.45, 0.53, 0.6, 0.68, 0.76, 0.84, 0.92, 1.0, 1.08):
        bump = sp.exp(-(((_r - _p) / _w) ** 2))
        shapes = (
            _shape("p", centre, 0.05, "speed of the bump"),
            _shape("w", 0.12, 0.03, "width of the bump"),
        )
        where = f"{centre:g} of the reference speed"
        result.append(
            _form(
                f"tilt_bump_{centre:g}",
                f"torque along the tilt near {where}",
                "rotor_torque",
                bump * _u,
                *shapes,
            )
        )
        result.append(
            _form(f"spin_bump_{centre:g}", f"torque on the spin near {where}", "shaft_torque", bump, *shapes)
        )
    for edge in (0.2, 0.3, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65):
        zone = sp.Max(_size - _p, 0) * _u / (_size + sp.Float(1e-9))
        begins = _shape("p", edge, 0.04, "tilt where it begins")
        text = f"torque along the tilt beyond {edge:g} of the reference tilt"
        result.append(_form(f"dead_zone_{edge:g}", text, "rotor_torque", zone, begins))
    for q in (3, 4):
        result.append(_form(f"spin_power_{q}", f"torque on the spin, speed^{q}", "shaft_torque", _r**q))
    result.append(_form("spin_tilt", "torque on the spin, |tilt|^2", "shaft_torque", _size**2))
    return tuple(result)


def search(problem: Problem, selection: Selection, *, progress: Progress | None = None) -> Proposal | None:
    """Look for a free form that describes the rows better than the selected effects; None if there is none.

    A form is compared by marginal likelihood with the size of the drifts left free, so that a misfit that an
    enlarged drift had covered is seen, and a real drift is not taken for a form.
    """
    if progress:
        progress("comparing with forms that no declared effect has")
    family = [
        Term(t.name, for_bench(t.effect, problem.bench))
        for t in forms()
        if t.effect is not None and t.name not in problem.known
    ]
    base = problem.evidence(selection.best)
    best: Proposal | None = None
    starts = [(selection.best, True)] + ([(selection.null, False)] if selection.findings else [])
    for start, keeps in starts:
        for _, term in rank(problem, start, family)[:_TRIED]:
            fit = problem.fit((*start.terms, term), start)
            gain = base - problem.evidence(fit)
            if best is None or gain > best.gain:
                best = Proposal(term, fit, gain, keeps)
    return best if best is not None and best.gain > UNKNOWN else None
