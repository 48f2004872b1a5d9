"""A campaign, from its settings to its statistics."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from gyrowheel.campaigns.result import CampaignResult

if TYPE_CHECKING:
    from gyrowheel.campaigns.cases import Campaign, Case, CaseKind
    from gyrowheel.campaigns.judge import Judged
    from gyrowheel_core.journal import Journal, Work
    from gyrowheel_sim.bench import Bench

KIND = "campaign"

#: What may be hidden if nothing is said, without and with imperfect instruments.
_KINDS = {False: ("none", "single", "pair", "outside"), True: ("none", "single", "event")}


def campaign(
    plan: str | Path = "survey",
    *,
    cases: int = 100,
    seed: int = 0,
    validation_plan: str | Path = "check",
    kinds: Sequence[str] = (),
    reality: bool = False,
    noise: float = 1.0,
    drift: float = 1.0,
    gains: float = 1.0,
    lost: float = 0.0,
    bench: str | Path | Bench = "gyrowheel",
    only: Sequence[int] = (),
    jobs: int | None = None,
    dask: str | None = None,
    keep: str | Path | None = None,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Sequence[Judged], int], None] | None = None,
) -> CampaignResult:
    """Test the diagnosis on many blind cases, each judged by its key.

    Each case is another machine: its parameters are drawn within their uncertainties, noise, drift and controller vary,
    and it hides nothing, one effect, two, or one that no library has.

    Parameters
    ----------
    plan, validation_plan : str or Path
        Plan that is diagnosed, and plan of the recording that is only predicted.
    cases : int
        Number of cases.
    seed : int
        Seed of everything that is drawn.
    kinds : sequence of str
        What may be hidden: ``none``, ``single``, ``pair``, ``outside``, with `reality` also ``event``. If not given,
        the first four; with `reality` ``none``, ``single`` and ``event``.
    reality : bool
        Whether the instruments are imperfect too, several at once, and events may happen.
    noise, drift, gains : float
        White noise, slow drifts and spin gains, times the stated ones.
    lost : float
        Fraction of the samples that is lost, 0 .. 0.2.
    bench : str, Path or Bench
        Shipped name of the bench, bench file, or bench.
    only : sequence of int
        Numbers of the cases to run; all if empty.
    jobs : int, optional
        Cases at a time; one per core if not given.
    dask : str, optional
        Address of a Dask scheduler whose workers run the cases.
    keep : str or Path, optional
        Folder that keeps recordings, keys and diagnoses.
    folder : str or Path, optional
        New folder that keeps each finished case, so that the campaign can go on after it was interrupted or killed.
    resume : bool
        Go on with the campaign in `folder`: cases that it finished are not run again. Settings must be the same, and
        so must the code.
    progress : callable, optional
        Called at the beginning and after each case with the cases finished so far, the latest last, and how many there
        are in all. Once it is called, everything given is known to be right.

    Returns
    -------
    CampaignResult
        The finished cases, also after Ctrl-C; if there are none, KeyboardInterrupt is raised again.

    Raises
    ------
    InputError
        If a name is unknown, a value is out of range, a folder cannot be written, or there is nothing to go on with.
    """
    from gyrowheel.campaigns.cases import Campaign
    from gyrowheel.campaigns.cases import cases as all_cases
    from gyrowheel.campaigns.finished import earlier, note
    from gyrowheel.campaigns.summary import Summary
    from gyrowheel.campaigns.workers import check_jobs, cores, judged_cases
    from gyrowheel_control.plans.adaptation import plan_for
    from gyrowheel_core.errors import InputError
    from gyrowheel_sim.bench import Bench

    if resume and folder is None:
        raise InputError("resume: needs the folder of the campaign to go on with")
    chosen_bench = bench if isinstance(bench, Bench) else Bench.load(bench)
    chosen, unused = plan_for(plan, chosen_bench), plan_for(validation_plan, chosen_bench)
    settings = Campaign(
        plan=chosen.to_yaml(),
        validation_plan=unused.to_yaml(),
        bench=chosen_bench,
        seed=seed,
        kinds=tuple(cast("CaseKind", kind) for kind in kinds or _KINDS[reality]),  # checked by Campaign
        reality=reality,
        noise=noise,
        drift=drift,
        gains=gains,
        lost=lost,
    )
    wanted = all_cases(settings, cases, only)
    jobs = cores() if jobs is None else jobs
    check_jobs(jobs)
    done: list[Judged] = []
    interrupted = False
    try:
        with (
            _keeping(keep, wanted, folder, resume) as kept,
            _kept(folder, settings, cases, only, resume) as (journal, scratch),
        ):
            done += [] if journal is None else earlier(journal, wanted)
            known = {case.index for case in done}
            left = [case for case in wanted if case.index not in known]
            if progress is not None:
                progress(done, len(wanted))
            with judged_cases(left, jobs=jobs, dask=dask, keep=kept, scratch=scratch) as results:
                for case in results:
                    if journal is not None:
                        note(journal, case)
                    done.append(case)
                    if progress is not None:
                        progress(done, len(wanted))
    except KeyboardInterrupt:
        if not done:
            raise
        interrupted = True
    varied = {"noise": noise, "drift": drift, "spin gains": gains}
    changes = [f"{name} × {value:g}" for name, value in varied.items() if value != 1.0]
    changes += ["imperfect instruments"] if reality else []
    changes += [f"{100.0 * lost:g} % of the samples lost"] if lost else []
    title = ", ".join([f"{len(wanted)} blind cases of plan {chosen.name}", f"seed {seed}", *changes])
    return CampaignResult(Summary.of(seed, len(wanted), done), title, interrupted)


def settings_of(folder: str | Path) -> dict[str, Any]:
    """Return the arguments of `campaign` with which the one in a folder was begun, all but what does not matter.

    Raises
    ------
    InputError
        If there is none.
    """
    from gyrowheel_core.journal import begun
    from gyrowheel_sim.bench import Bench

    found = begun(Path(folder), KIND).settings
    return found | {"bench": Bench.from_text(found["bench"], origin=str(folder))}


def _work(campaign: Campaign, count: int, only: Sequence[int]) -> Work:
    """Return what determines the results of a campaign; plans and bench by what is in them."""
    from gyrowheel.simulation.code_identity import code_identity
    from gyrowheel_core.journal import Work

    single = ("plan", "validation_plan", "seed", "kinds", "reality", "noise", "drift", "gains", "lost")
    settings = {name: getattr(campaign, name) for name in single}
    settings |= {"bench": campaign.bench.describe(), "cases": count, "only": sorted({*only})}
    return Work(kind=KIND, settings=settings, versions=code_identity())


@contextlib.contextmanager
def _keeping(
    keep: str | Path | None, wanted: Sequence[Case], folder: str | Path | None, resume: bool
) -> Iterator[str | None]:
    """Hold the folder that keeps the recordings of cases, and yield its path from the root; None without one.

    Two campaigns at once would replace each other's cases.
    """
    if keep is None:
        yield None
        return
    from gyrowheel.campaigns.job import kept_case
    from gyrowheel_core.errors import InputError
    from gyrowheel_core.files import disk_errors
    from gyrowheel_core.locks import alone_in

    place = Path(keep)
    with disk_errors(place):
        place.mkdir(parents=True, exist_ok=True)
        is_held = folder is not None and place.resolve() == Path(folder).resolve()
    with contextlib.nullcontext() if is_held else alone_in(place, KIND):
        there = [] if resume else [own for case in wanted if (own := kept_case(place, case.index)).exists()]
        if there:
            raise InputError(f"keep: {there[0]} exists, of another campaign; name a new folder")
        yield str(place.absolute())


@contextlib.contextmanager
def _kept(
    folder: str | Path | None, campaign: Campaign, count: int, only: Sequence[int], resume: bool
) -> Iterator[tuple[Journal | None, str | None]]:
    """Yield the journal of a campaign and a folder for its temporary files; neither where nothing is to be kept."""
    if folder is None:
        yield None, None
        return
    from gyrowheel_core.files import disk_errors
    from gyrowheel_core.journal import journal

    with journal(Path(folder), _work(campaign, count, only), resume=resume) as kept:
        scratch = kept.folder.absolute() / "scratch"
        shutil.rmtree(scratch, ignore_errors=True)  # what a kill has left
        try:
            with disk_errors(scratch):
                scratch.mkdir()
            yield kept, str(scratch)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
