"""Effects, test plans and benches: by name, new files of them, and checks."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from gyrowheel.catalogue.plan_check import CheckedPlan, check_text
from gyrowheel.show.result import Result
from gyrowheel_core.arrays import one_thread
from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel_analysis.capability import Reach
    from gyrowheel_control.plans.plan import Plan as Plan
    from gyrowheel_sim.bench import Bench as Bench
    from gyrowheel_sim.effects import Effect as Effect

T = TypeVar("T")
_OWN: Final = "own"  # name of a formula without one


class Catalogue(Mapping[str, T], Generic[T]):
    """A read-only mapping of names to effects, plans or benches, which are loaded when used.

    An unknown name raises `UnknownName`, a `KeyError` and an `InputError` with the nearest names.
    """

    def __init__(self, kind: str, names: Callable[[], list[str]], load: Callable[[str], T]) -> None:
        self._kind, self._names, self._load = kind, names, load

    def __getitem__(self, name: str) -> T:
        """Return the item of a name."""
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
        """Return the number of items."""
        return len(self._names())

    def __contains__(self, name: object) -> bool:
        """Whether an item has that name."""
        return name in self._names()

    def __repr__(self) -> str:
        """Return the names."""
        return f"<{self._kind} catalogue: {', '.join(self)}>"


class UnknownName(InputError, KeyError):
    """Unknown name of an effect, plan or bench."""

    def __str__(self) -> str:
        """Return the message as it is: KeyError would quote it."""
        return str(self.args[0])


def _effect_names() -> list[str]:
    from gyrowheel_sim.effects import registry

    return list(registry())


def effect_on(name: str, bench: Bench | None = None) -> Effect:
    """Return an effect, with its usual sizes on a bench; InputError for an unknown name."""
    from gyrowheel_sim.effects import get

    return get(name, bench=bench)


def _plan_names() -> list[str]:
    from gyrowheel_control.plans.plan import Plan

    return Plan.shipped()


def load_plan(source: str | Path) -> Plan:
    """Return a test plan: shipped name, plan file or text of one; also varied, as ``quick@rig=inverted``.

    InputError for an unknown name, or a field that is missing, unknown or out of range.
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


def load_bench(source: str | Path | Bench = "gyrowheel") -> Bench:
    """Return a bench: given as such, by its shipped name or its file; InputError if it is unknown or has errors."""
    from gyrowheel_sim.bench import Bench

    return source if isinstance(source, Bench) else Bench.load(source)


#: Known physical effects: title, physics, formula, coefficients with units, usual sizes and sources.
effects: Final[Catalogue[Effect]] = Catalogue("effect", _effect_names, effect_on)
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
    """Return a user-defined effect, to be added to a model or to a simulated machine.

    Parameters
    ----------
    formula : str
        Law such as ``-k*r^2*z``, in the syntax of docs/formulas.md. It may begin with a name and a colon. Units of
        the coefficients follow from the law, or are given in the text.
    name : str, optional
        Name of the effect; that of the formula, if it has one, must be the same. ``own`` by default.
    target : str, optional
        What the law acts on; the torque on the rotor if not given.
    taken : container of str
        Names that are in use: an effect without a name is called ``own_2``, ``own_3`` and so on then.
    where : str
        Beginning of error messages.

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


@dataclass(frozen=True, repr=False)
class PlanCheck(Result, CheckedPlan):
    """Outcome of `gyrowheel.check_plan`: the fields of `gyrowheel.catalogue.plan_check.CheckedPlan`."""

    def headline(self) -> str:
        """Return the number of errors."""
        count = len(self.wrong)
        many = "nothing wrong" if not count else "one error" if count == 1 else f"{count} errors"
        return f"{self.file}: {many}, bench {self.bench}"

    def page(self) -> Iterable[RenderableType]:
        """Return all errors of the plan file, or its content and demands."""
        from gyrowheel.catalogue.page import check_page

        return check_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel plans --check --json``."""
        return {
            "schema": 1,
            "file": self.file,
            "bench": self.bench,
            "good": self.good,
            "wrong": [item._asdict() for item in self.wrong],
            "outlook": None if self.outlook is None else asdict(self.outlook),
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return a row for each error: line, place, text."""
        return {name: [getattr(item, name) for item in self.wrong] for name in ("line", "place", "said")}


def check_plan(file: str | Path, bench: str | Path | Bench = "gyrowheel") -> PlanCheck:
    """Check a plan file: return all its errors, or its content and its demands on the bench.

    Parameters
    ----------
    file : str or Path
        The plan file.
    bench : str, Path or Bench
        The bench that shall run it.

    Raises
    ------
    InputError
        If the file cannot be read, or is no YAML.
    """
    from gyrowheel_core.files import read_text

    return PlanCheck.of(check_text(read_text(Path(file), errors="replace"), str(file), load_bench(bench)))


def new_plan(file: str | Path, bench: str | Path | Bench = "gyrowheel") -> None:
    """Write a plan file to begin with, which the bench can run; InputError if the file exists."""
    from gyrowheel_control.plans.adaptation import plan_template

    _write_new(Path(file), lambda: plan_template(load_bench(bench), Path(file).stem))


def plan_schema() -> dict[str, Any]:
    """Return the JSON schema of plan files, with which editors complete and check them."""
    from gyrowheel_control.plans.plan import json_schema

    return json_schema()


def new_bench(file: str | Path, like: str | Path | Bench = "gyrowheel") -> None:
    """Write a bench file to begin with: a copy of another bench with a comment for every value; a new file only."""
    from gyrowheel_sim.bench import bench_text

    _write_new(Path(file), lambda: bench_text(load_bench(like), Path(file).stem))


def _write_new(file: Path, text: Callable[[], str]) -> None:
    from gyrowheel_core.files import write_text

    content = text()
    if file.exists():
        raise InputError(f"{file}: exists; name a new file")
    write_text(file, content)


def reach(bench: str | Path | Bench = "gyrowheel") -> Reach:
    """Return the capability of a bench: speeds, tilts and rates that its coils and its motor can reach."""
    from gyrowheel_analysis.capability import reach as reach_of

    with one_thread():
        return reach_of(load_bench(bench))


def reach_json(found: Reach) -> dict[str, Any]:
    """Return a capability as a JSON object; SI units."""
    return {"speeds": [asdict(own) for own in found.speeds], "largest_tilt": found.largest_tilt}
