"""A campaign, from its settings to its statistics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, cast

from gyrowheel.results.campaign import CampaignResult

if TYPE_CHECKING:
    from gyrowheel.campaigns.cases import CaseKind
    from gyrowheel.campaigns.judge import Judged

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
    bench: str | Path = "gyrowheel",
    only: Sequence[int] = (),
    jobs: int | None = None,
    dask: str | None = None,
    keep: str | Path | None = None,
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
    bench : str or Path
        Shipped name of the bench, or bench file.
    only : sequence of int
        Numbers of the cases to run; all if empty.
    jobs : int, optional
        Cases at a time; one per core if not given.
    dask : str, optional
        Address of a Dask scheduler whose workers run the cases.
    keep : str or Path, optional
        Folder that keeps recordings, keys and diagnoses.
    progress : callable, optional
        Called at the beginning and after each case with the cases finished so far, the latest last, and how many there
        are in all.

    Returns
    -------
    CampaignResult
        The finished cases, also after Ctrl-C; if there are none, KeyboardInterrupt is raised again.

    Raises
    ------
    InputError
        If a name is unknown, a value is out of range, or the folder cannot be written.
    """
    from gyrowheel.campaigns.cases import Campaign
    from gyrowheel.campaigns.cases import cases as all_cases
    from gyrowheel.campaigns.summary import Summary
    from gyrowheel.campaigns.workers import cores, judged_cases
    from gyrowheel_control.plans.plan import Plan
    from gyrowheel_core.files import disk_errors
    from gyrowheel_sim.bench import Bench

    chosen, unused = Plan.load(plan), Plan.load(validation_plan)
    settings = Campaign(
        plan=chosen.to_yaml(),
        validation_plan=unused.to_yaml(),
        bench=Bench.load(bench),
        seed=seed,
        kinds=tuple(cast("CaseKind", kind) for kind in kinds or _KINDS[reality]),  # checked by Campaign
        reality=reality,
        noise=noise,
        drift=drift,
        gains=gains,
        lost=lost,
    )
    wanted = all_cases(settings, cases, only)
    kept = None
    if keep is not None:
        with disk_errors(Path(keep)):
            Path(keep).mkdir(parents=True, exist_ok=True)
        kept = str(Path(keep).absolute())
    done: list[Judged] = []
    if progress is not None:
        progress(done, len(wanted))
    interrupted = False
    try:
        with judged_cases(wanted, jobs=cores() if jobs is None else jobs, dask=dask, keep=kept) as results:
            for case in results:
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
