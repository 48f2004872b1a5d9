"""What there is: effects, test plans and benches, each by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Container, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel_control.plans.plan import Plan as Plan
    from gyrowheel_sim.bench import Bench as Bench
    from gyrowheel_sim.effects import Effect as Effect

T = TypeVar("T")
_OWN: Final = "own"  # name of a formula that was given none


class Catalogue(Mapping[str, T], Generic[T]):
    """A read-only mapping of names to what they stand for; loaded when used.

    A name that is not in it raises `UnknownName`, a `KeyError` and an `InputError` with the nearest names.
    """

    def __init__(self, kind: str, names: Callable[[], list[str]], load: Callable[[str], T]) -> None:
        self._kind, self._names, self._load = kind, names, load

    def __getitem__(self, name: str) -> T:
        """Return what a name stands for."""
        names = self._names()
        if name not in names:
            near = difflib.get_close_matches(str(name), names, n=3, cutoff=0.4)
            hint = f"did you mean {', '.join(near)}?" if near else f"known: {', '.join(names)}"
            raise UnknownName(f"{self._kind}: '{name}' is not known; {hint}")
        return self._load(name)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._names())

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self._names())

    def __contains__(self, name: object) -> bool:
        """Whether there is one of that name."""
        return name in self._names()

    def __repr__(self) -> str:
        """Return the names."""
        return f"<{self._kind} catalogue: {', '.join(self)}>"


class UnknownName(InputError, KeyError):
    """A name that a catalogue does not have."""

    def __str__(self) -> str:
        """Return the message as it is: KeyError would quote it."""
        return str(self.args[0])


def _effect_names() -> list[str]:
    from gyrowheel_sim.effects import registry

    return list(registry())


def _effect(name: str) -> Effect:
    from gyrowheel_sim.effects import get

    return get(name)


def effect_on(bench: Bench, name: str) -> Effect:
    """Return an effect with its usual sizes on a bench; InputError if there is none of that name."""
    from gyrowheel_sim.effects import get

    return get(name, bench=bench)


def _plan_names() -> list[str]:
    from gyrowheel_control.plans.plan import Plan

    return Plan.shipped()


def load_plan(source: str | Path) -> Plan:
    """Return a test plan.

    Parameters
    ----------
    source : str or Path
        Shipped name, plan file or text of one; also varied, as ``quick@rig=inverted``.

    Raises
    ------
    InputError
        If there is no such plan, or a field of it is missing, unknown or out of range.
    """
    from gyrowheel_control.plans.plan import Plan

    return Plan.load(source)


def plan_on(bench: Bench, source: str | Path) -> Plan:
    """Return a plan as a bench runs it, checked: a shipped one with the bench's own speeds, tilts and rates."""
    from gyrowheel_control.plans.adaptation import plan_for

    return plan_for(source, bench)


def plans_on(bench: Bench) -> list[Plan]:
    """Return the shipped plans as a bench runs them."""
    first = next(iter(benches))
    return [plan_on(bench, name) for name, plan in plans.items() if plan.written_for == first]


def _bench_names() -> list[str]:
    from gyrowheel_sim.bench import Bench

    return Bench.shipped()


def load_bench(source: str | Path = "gyrowheel") -> Bench:
    """Return a bench: a shipped name or a bench file; InputError if there is none, or it has errors."""
    from gyrowheel_sim.bench import Bench

    return Bench.load(source)


#: Known physical effects: title, physics, formula, coefficients with units, usual sizes and sources.
effects: Final[Catalogue[Effect]] = Catalogue("effect", _effect_names, _effect)
#: Test plans that come with the project.
plans: Final[Catalogue[Plan]] = Catalogue("plan", _plan_names, load_plan)
#: Benches that come with the project: every parameter with value, uncertainty and source.
benches: Final[Catalogue[Bench]] = Catalogue("bench", _bench_names, load_bench)


def own_effect(
    formula: str,
    *,
    name: str | None = None,
    target: str | None = None,
    taken: Container[str] = (),
    where: str = "formula",
) -> Effect:
    """Return an effect made of a formula, to be added to a model or to a simulated machine.

    Parameters
    ----------
    formula : str
        Law such as ``-k*r^2*z``; docs/formulas.md describes what can be written. It may begin with a name and a
        colon. Units of the coefficients follow from the law, or stand in the text.
    name : str, optional
        Name of the effect; where the formula has one, the same. ``own`` if there is none.
    target : str, optional
        What the law acts on; the torque on the rotor if not given.
    taken : container of str
        Names that an effect without a name must not get: it is called ``own_2``, ``own_3`` and so on then.
    where : str
        What messages begin with.

    Raises
    ------
    InputError
        If the formula cannot be read, its units do not agree, or its name is that of a known effect.
    """
    from gyrowheel.show.formulas import plain
    from gyrowheel_sim.effects import registry
    from gyrowheel_sim.effects.user_defined import check_name
    from gyrowheel_sim.effects.user_defined_line import typed_effect

    free, number = _OWN, 2
    while free in taken:
        free, number = f"{_OWN}_{number}", number + 1
    effect = typed_effect(plain(formula), name=name, otherwise=free, target=target, where=where)
    check_name(effect.name, where, registry())
    return effect
