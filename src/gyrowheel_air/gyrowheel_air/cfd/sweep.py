"""Sweeps of many cases, one a core, each starting from a finished neighbour, none computed twice."""

from __future__ import annotations

import contextlib
import math
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gyrowheel_air.cfd import openfoam
from gyrowheel_air.cfd.case import Case, Result, finished, run_case
from gyrowheel_air.cfd.mesh import MESHES
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.locks import alone_in
from gyrowheel_core.processes import end_with, hindrance

#: Called after every case with the case, its result or the reason of its failure, the number done and the total.
Tell = Callable[[Case, "Result | str", int, int], None]


@dataclass(frozen=True)
class Step:
    """A case, and the case whose solution it starts from."""

    case: Case  # the case to run
    first: Case | None = None  # where its first guess comes from; must be of an earlier level


@dataclass(frozen=True)
class Outcome:
    """Result of a sweep."""

    results: list[Result]  # finished cases, in the order of the plan
    failed: dict[str, str]  # reason by name of the case
    reused: int  # finished cases that were there already


def plan(
    template: Case, tilts: Sequence[float], speeds: Sequence[float], base_speed: float
) -> list[list[Step]]:
    """Return the steps of a sweep over tilt and speed, in levels that depend on earlier levels only.

    Each tilt is computed at one base speed first; its other speeds start from there, the solution scaled. A start from
    another tilt would save the k-epsilon iterations, but SST started so went unsteady.

    Parameters
    ----------
    template : Case
        All but tilt and speed.
    tilts, speeds : sequences of float
        Grid [rad], [rad/s].
    base_speed : float
        Wanted base [rad/s]; the nearest of the speeds is taken.
    """
    base = min(speeds, key=lambda speed: abs(speed - base_speed))
    at_base = {tilt: replace(template, tilt=tilt, spin_rate=base) for tilt in tilts}
    first = [Step(case) for case in at_base.values()]
    # a scaled solution is nearly there: three fifths of the iterations are enough
    warm = max(template.window, 3 * template.iterations // 5)
    rest = [
        Step(replace(template, tilt=tilt, spin_rate=speed, start_iterations=0, iterations=warm), case)
        for tilt, case in at_base.items()
        for speed in speeds
        if speed != base
    ]
    return [first, rest] if rest else [first]


def companions(template: Case, tilt: float, speed: float) -> list[Step]:
    """Return the cases that show the dependence of a table on mesh, turbulence model and axes.

    All at one speed, most at one tilt: the tilt backwards, the tilt turned by 45 deg, the other meshes, the other
    models; and the meshes without tilt, where only the drag is not zero by symmetry.

    Parameters
    ----------
    template : Case
        All but tilt and speed.
    tilt, speed : float
        Where [rad], [rad/s].
    """
    there = replace(template, tilt=tilt, spin_rate=speed)
    upright = replace(there, tilt=0.0)
    # a model shows its part on the mesh of the table, so far as that suits it
    resolved = "low_re" if MESHES[template.mesh].wall_functions else template.mesh
    methods = [
        ("low_re", "sst"),
        ("low_re_fine", "sst"),
        (resolved, "laminar"),
        ("low_re", "paper"),
        ("coarse", "paper"),
        ("medium", "paper"),
        ("fine", "paper"),
    ]
    others = [m for m in methods if m != (template.mesh, template.model)]
    steps = [replace(there, tilt=-tilt), replace(there, direction=0.25 * math.pi)]
    for place in (there, upright):
        # without tilt the finest of all would only repeat what the coarser ones show
        steps += [
            replace(place, mesh=mesh, model=model)
            for mesh, model in others
            if place is there or mesh != "fine"
        ]
    return [Step(case) for case in steps]


def sweep(
    levels: Iterable[Sequence[Step]],
    root: Path,
    *,
    jobs: int = 1,
    dask: str | None = None,
    begin: Callable[[], object] | None = None,
    tell: Tell,
) -> Outcome:
    """Run the cases of a plan that have no result yet.

    Parameters
    ----------
    levels : sequence of sequences of Step
        Cases of one level run at the same time.
    root : Path
        Folder of the study. With `dask`, all workers must see it under this path.
    jobs : int
        Cases at a time, one core each.
    dask : str, optional
        Address of a Dask scheduler that runs them in place of this machine.
    begin : callable, optional
        Called when the folder is held and before the first case is computed; not where all are there already.
    tell : callable
        Told after each case, those first that were there already.

    Raises
    ------
    InputError
        If OpenFOAM is not installed and something is to be computed, another sweep works in the folder, or Dask is
        asked for and not there.
    """
    levels = [list(level) for level in levels]
    order = [step.case for level in levels for step in level]
    results: dict[str, Result] = {}
    failed: dict[str, str] = {}
    root = root.resolve()

    def note(case: Case, outcome: Result | str) -> None:
        if isinstance(outcome, str):
            failed[case.name] = outcome
        else:
            results[case.name] = outcome
        tell(case, outcome, len(results) + len(failed), len(order))

    for case in order:
        known = finished(root / case.name, case)
        if known is not None:
            note(case, known)
    reused = len(results)
    if reused < len(order):
        if dask is None:
            openfoam.require()  # with Dask the workers need it, not this machine
        root.mkdir(parents=True, exist_ok=True)
        with alone_in(root, "sweep"), _workers(jobs, dask) as run_all:
            if begin is not None:
                begin()
            for level in levels:
                todo = []
                for step in level:
                    if step.case.name in results:
                        continue
                    if step.first is not None and step.first.name in failed:
                        note(step.case, f"not run: its first guess, {step.first.name}, failed")
                        continue
                    todo.append(step)
                for case, outcome in run_all(todo, root):
                    note(case, outcome)
    return Outcome([results[c.name] for c in order if c.name in results], failed, reused)


def _one(step: Step, root: Path, sweeper: int | None) -> tuple[Case, Result | str]:
    """Run one case; a failure is returned, not raised, so that the others continue."""
    if sweeper is not None:
        end_with(sweeper)  # a worker of a sweep that is killed must not go on alone
    first = None if step.first is None else root / step.first.name
    try:
        return step.case, run_case(step.case, root, first=first)
    except InputError as error:
        return step.case, str(error)


RunAll = Callable[[Sequence[Step], Path], Iterator[tuple[Case, "Result | str"]]]


@contextlib.contextmanager
def _workers(jobs: int, dask: str | None) -> Iterator[RunAll]:
    # threads do where processes cannot: the work is OpenFOAM's
    threads = dask is None and bool(hindrance())
    with warnings.catch_warnings():
        if threads:  # told by joblib
            warnings.simplefilter("ignore")
        import joblib

    with contextlib.ExitStack() as stack:
        if dask is not None:
            stack.enter_context(_dask(dask))

        def run_all(steps: Sequence[Step], root: Path) -> Iterator[tuple[Case, Result | str]]:
            if not steps:
                return iter(())
            kind = "generator_unordered"
            how: dict[str, Any] = {} if dask else {"n_jobs": jobs}
            how |= {"backend": "threading"} if threads else {}
            pool = joblib.Parallel(return_as=kind, batch_size=1, **how)
            sweeper = None if dask else os.getpid()
            return iter(pool(joblib.delayed(_one)(step, root, sweeper) for step in steps))

        yield run_all


@contextlib.contextmanager
def _dask(address: str) -> Iterator[None]:
    try:
        from dask.distributed import Client
    except ImportError:
        raise InputError(
            "dask: needs the package distributed, which is not installed: pip install 'gyrowheel-sim[dask]'"
        ) from None
    import joblib

    try:
        client = Client(address, timeout="10s")
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"dask: no scheduler answers at {address} ({one_line(error)}); "
            "expected an address such as tcp://10.0.0.5:8786"
        ) from None
    with client, joblib.parallel_config(backend="dask", wait_for_workers_timeout=60):
        yield
