"""One case from beginning to end, and the workers that run the cases: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.finder import find
from gyrowheel.campaigns.hidden import Secret, hide, record, yardstick
from gyrowheel.campaigns.judge import Judged, failed, judge
from gyrowheel.show.contract import diagnosis_json
from gyrowheel_analysis.model import Model
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.files import disk_errors, json_text, temporary_path, write_text
from gyrowheel_core.processes import end_with, hindrance

_CONNECT = 20.0  # s


def run_case(case: Case, keep: str | None = None, scratch: str | None = None) -> Judged:
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


def cores() -> int:
    """Return the number of cases that this machine can run at a time."""
    if hindrance():
        return 1
    import joblib

    return int(joblib.cpu_count())


def one_at_a_time() -> str:
    """Return why this machine can run only one case at a time; empty if it can run several."""
    why = hindrance()
    return f"one case at a time: {why}" if why else ""


def check_jobs(jobs: int) -> None:
    """Refuse an impossible number of processes: less than one, or several where processes cannot share work."""
    if jobs < 1:
        raise InputError(f"jobs: {jobs} is out of range; allowed: >= 1")
    if jobs > 1 and (why := hindrance()):
        raise InputError(f"jobs: {jobs} is out of range; allowed: 1, since {why}")


@contextlib.contextmanager
def judged_cases(
    cases: Sequence[Case],
    *,
    jobs: int,
    dask: str | None = None,
    keep: str | None = None,
    scratch: str | None = None,
) -> Iterator[Iterator[Judged]]:
    """Yield an iterator over judged cases in the order in which they finish; leaving the block ends all work.

    The cases run in `jobs` processes (in this one if there is one job), or on the workers of a Dask scheduler, which
    need this software and must be able to write to `keep`. InputError if `jobs` is impossible, Dask is not installed,
    or the scheduler does not answer.
    """
    check_jobs(jobs)
    if not cases:
        yield iter(())
    elif dask is not None:
        with _on_cluster(cases, dask, keep) as results:
            yield results
    elif jobs == 1 or len(cases) == 1:
        yield (run_case(case, keep, scratch) for case in cases)
    else:
        with _in_processes(cases, jobs, keep, scratch) as results:
            yield results


@contextlib.contextmanager
def _in_processes(
    cases: Sequence[Case], jobs: int, keep: str | None, scratch: str | None
) -> Iterator[Iterator[Judged]]:
    import joblib
    from joblib.externals.loky import get_reusable_executor

    parallel = joblib.Parallel(
        n_jobs=min(jobs, len(cases)), return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs"
    )
    with (
        _told(),
        # owned by this process: workers that are ended within a case leave their files behind
        tempfile.TemporaryDirectory(prefix="campaign-", dir=scratch) as place,
        _ended(get_reusable_executor),
        joblib.parallel_config("loky", inner_max_num_threads=1),
    ):
        # the workers inherit the blocked signal: Ctrl-C reaches this process alone, which then ends them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            results = parallel(joblib.delayed(_one)(case, keep, place, os.getpid()) for case in cases)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        with contextlib.closing(results):
            yield results


@contextlib.contextmanager
def _told() -> Iterator[None]:
    """Report a worker that was killed, as the kernel does when memory is short."""
    from joblib.externals.loky.process_executor import BrokenProcessPool

    try:
        yield
    except BrokenProcessPool:
        raise InputError(
            "jobs: a worker was killed, as the machine does when its memory is full; fewer jobs at a time need less"
        ) from None


def _one(case: Case, keep: str | None, scratch: str, campaign: int) -> Judged:
    """Run a case in a worker of the process of this number."""
    end_with(campaign)  # a worker of a campaign that is killed must not go on alone
    return run_case(case, keep, scratch)


@contextlib.contextmanager
def _ended(executor: Any) -> Iterator[None]:
    """Kill the workers at the end of the block."""
    try:
        yield
    finally:
        executor().shutdown(wait=True, kill_workers=True)


@contextlib.contextmanager
def _on_cluster(cases: Sequence[Case], address: str, keep: str | None) -> Iterator[Iterator[Judged]]:
    try:
        from dask.distributed import Client, as_completed
    except ImportError:
        raise InputError(
            "dask: needs the package distributed, which is not installed: pip install 'gyrowheel[dask]'"
        ) from None
    try:
        client: Any = Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = one_line(error)
        raise InputError(
            f"dask: no scheduler answers at {address} ({reason}); expected an address such as tcp://10.0.0.5:8786"
        ) from None
    with client:
        # pure=False: two campaigns on one cluster must not share results
        futures = client.map(run_case, cases, keep=keep, pure=False, retries=1)
        try:
            yield (future.result() for future in as_completed(futures, loop=client.loop))
        finally:
            client.cancel(futures)
