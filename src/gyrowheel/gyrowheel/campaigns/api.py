"""A campaign of blind cases, from its settings to its statistics; each case is simulated, diagnosed, judged, kept."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import tempfile
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from pydantic import TypeAdapter, ValidationError
from rich.console import RenderableType
from threadpoolctl import threadpool_limits

from gyrowheel.batches.workers import check_jobs, cores, finished
from gyrowheel.campaigns.cases import Campaign, Case, CaseKind
from gyrowheel.campaigns.cases import cases as all_cases
from gyrowheel.campaigns.finder import find
from gyrowheel.campaigns.hidden import Secret, hide, record, yardstick
from gyrowheel.campaigns.judge import Judged, failed, judge
from gyrowheel.campaigns.page import campaign_page, tally
from gyrowheel.campaigns.summary import Summary
from gyrowheel.show.contract import diagnosis_json
from gyrowheel.show.result import Result
from gyrowheel.simulation.code_identity import code_identity
from gyrowheel_analysis.model import Model
from gyrowheel_control.plans.adaptation import plan_for
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import disk_errors, json_text, temporary_path, write_text
from gyrowheel_core.journal import Journal, Work, begun, journal
from gyrowheel_core.locks import alone_in
from gyrowheel_sim.bench import Bench


def run_case(keep: str | None, case: Case, scratch: str | None = None) -> Judged:
    """Simulate a case, diagnose it, and judge the answer; the case determines the result completely.

    `keep` is a folder that keeps recordings, key and diagnosis, `scratch` one for temporary files; both must exist.
    InputError if recordings cannot be written; MemoryError and OSError if the machine lacks something.
    """
    # not undone: several threads of one worker may run cases, and all need this limit
    threadpool_limits(limits=1, user_api="blas")
    campaign = case.campaign
    secret = hide(case, yardstick(campaign.bench, campaign.plan))
    folder = Path(tempfile.mkdtemp(prefix=f"case-{case.index}-", dir=scratch))
    try:
        recording, unused = folder / "recording", folder / "unused"
        record(case, secret, campaign.plan, 0, recording)
        record(case, secret, campaign.validation_plan, 1, unused)
        judged = _answered(case, secret, recording, unused, folder)
        if keep is not None:
            write_text(folder / "key.json", json_text(secret.to_json()), private=True)
            _move(folder, kept_case(keep, case.index))
        return judged
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def kept_case(keep: str | Path, index: int) -> Path:
    """Return the folder in which a case is kept."""
    return Path(keep) / f"case-{index:04d}"


def _answered(case: Case, secret: Secret, recording: Path, unused: Path, folder: Path) -> Judged:
    try:
        answer = find(recording, unused, Model(case.campaign.bench))
    except (MemoryError, OSError):  # of the computer, and no wrong answer: the campaign can be resumed
        raise
    except Exception as error:  # one failed case must not end the others
        write_text(folder / "error.txt", traceback.format_exc())
        return failed(case, secret, f"{type(error).__name__}: {one_line(error)}")
    write_text(folder / "diagnosis.json", json_text(diagnosis_json(answer)))
    return judge(case, secret, answer)


def _move(folder: Path, target: Path) -> None:
    """Copy a folder to a place where it appears as a whole."""
    with disk_errors(target), temporary_path(target, folder=True, mode=0o700) as (place, _):
        shutil.copytree(folder, place / target.name)
        shutil.rmtree(target, ignore_errors=True)  # of this case, before the campaign was interrupted
        os.replace(place / target.name, target)


KIND = "campaign"

#: Default kinds of cases, without and with imperfect instruments.
_KINDS = {False: ("none", "single", "pair", "outside"), True: ("none", "single", "event")}


@dataclass(frozen=True, repr=False)
class CampaignResult(Result, Summary):
    """Outcome of `gyrowheel.campaign`; fields and statistics are those of `gyrowheel.campaigns.summary.Summary`."""

    def headline(self) -> str:
        """Return the title and the numbers of right and wrong answers."""
        return f"{self.title}: {tally(self)}"

    def page(self) -> Iterable[RenderableType]:
        """Return the tables of the campaign."""
        return campaign_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel campaign --json``."""
        return self.to_json()

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the cases as columns, a row for each."""
        return {
            "case": [case.index for case in self.cases],
            "kind": [case.kind for case in self.cases],
            "hidden": [", ".join(case.truth) for case in self.cases],
            "named": [", ".join(case.named) for case in self.cases],
            "verdict": [case.verdict for case in self.cases],
            "outcome": [case.outcome for case in self.cases],
            "detectable": [case.detectable for case in self.cases],
        }


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
    and it hides no effect, one, two, or one outside the library.

    Parameters
    ----------
    plan, validation_plan : str or Path
        Plan that is diagnosed, and plan of the validation recording.
    cases : int
        Number of cases.
    seed : int
        Seed of all draws.
    kinds : sequence of str
        Kinds of cases: ``none``, ``single``, ``pair``, ``outside``, with `reality` also ``event``. If not given,
        the first four; with `reality` ``none``, ``single`` and ``event``.
    reality : bool
        Whether instruments are imperfect, several at once, and events happen.
    noise, drift, gains : float
        White noise, slow drifts and spin gains, as multiples of the stated ones.
    lost : float
        Fraction of lost samples, 0 .. 0.2.
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
        New folder that keeps each finished case, so that an interrupted or killed campaign can be resumed.
    resume : bool
        Resume the campaign in `folder`: finished cases are not run again. Settings and code must be the same.
    progress : callable, optional
        Called at the beginning and after each case with the finished cases, the latest last, and the number of all
        cases. At its first call all settings are checked.

    Returns
    -------
    CampaignResult
        The finished cases, also after Ctrl-C; without any, KeyboardInterrupt is raised again.

    Raises
    ------
    InputError
        If a name is unknown, a value is out of range, a folder cannot be written, or there is nothing to resume.
    """
    if resume and folder is None:
        raise InputError("resume: needs the folder of the campaign")
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
            _kept(folder, settings, cases, only, resume) as (kept_cases, scratch),
        ):
            done += [] if kept_cases is None else _earlier(kept_cases, wanted)
            known = {case.index for case in done}
            left = [case for case in wanted if case.index not in known]
            if progress is not None:
                progress(done, len(wanted))
            call = functools.partial(run_case, kept)
            with finished(call, left, jobs=jobs, dask=dask, scratch=scratch) as results:
                for case in results:
                    if kept_cases is not None:
                        kept_cases.finish(f"case-{case.index:04d}", asdict(case))
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
    return CampaignResult.of(Summary.counted(seed, len(wanted), done, title, interrupted=interrupted))


def settings_of(folder: str | Path) -> dict[str, Any]:
    """Return the arguments of `campaign` that determine the results of the campaign in a folder."""
    found = begun(Path(folder), KIND).settings
    return found | {"bench": Bench.from_text(found["bench"], origin=str(folder))}


def _earlier(kept: Journal, wanted: Sequence[Case]) -> list[Judged]:
    """Return the finished cases of a journal, of those wanted."""
    adapter = TypeAdapter(Judged)
    kinds = {case.index: case.kind for case in wanted}
    found: dict[int, Judged] = {}
    for content in kept.finished().values():
        with contextlib.suppress(ValidationError):
            case = adapter.validate_python(content)
            if kinds.get(case.index) == case.kind:
                found[case.index] = case
    return list(found.values())


def _work(campaign: Campaign, count: int, only: Sequence[int]) -> Work:
    """Return the settings that determine the results of a campaign; plans and bench by their contents."""
    single = ("plan", "validation_plan", "seed", "kinds", "reality", "noise", "drift", "gains", "lost")
    settings = {name: getattr(campaign, name) for name in single}
    settings |= {"bench": campaign.bench.describe(), "cases": count, "only": sorted({*only})}
    return Work(kind=KIND, settings=settings, versions=code_identity())


@contextlib.contextmanager
def _keeping(
    keep: str | Path | None, wanted: Sequence[Case], folder: str | Path | None, resume: bool
) -> Iterator[str | None]:
    """Lock the folder that keeps the recordings of cases, and yield its absolute path; None without one.

    Two campaigns at once would replace each other's cases.
    """
    if keep is None:
        yield None
        return
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
    """Yield the journal of a campaign and a folder for its temporary files; None for both without a folder."""
    if folder is None:
        yield None, None
        return
    with journal(Path(folder), _work(campaign, count, only), resume=resume) as kept:
        scratch = kept.folder.absolute() / "scratch"
        shutil.rmtree(scratch, ignore_errors=True)  # left by a kill
        try:
            with disk_errors(scratch):
                scratch.mkdir()
            yield kept, str(scratch)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
