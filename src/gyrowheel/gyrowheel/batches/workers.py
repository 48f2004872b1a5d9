"""Workers that call a function of many items: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.processes import end_with, hindrance

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")

_CONNECT = 20.0  # s


def cores() -> int:
    """Return the number of items that this machine can work on at a time."""
    if hindrance():
        return 1
    import joblib

    return int(joblib.cpu_count())


def one_at_a_time() -> str:
    """Return why this machine can work on only one item at a time; empty if it can on several."""
    why = hindrance()
    return f"one at a time: {why}" if why else ""


def check_jobs(jobs: int) -> None:
    """Refuse an impossible number of processes: less than one, or several where processes cannot share work."""
    if jobs < 1:
        raise InputError(f"jobs: {jobs} is out of range; allowed: >= 1")
    if jobs > 1 and (why := hindrance()):
        raise InputError(f"jobs: {jobs} is out of range; allowed: 1, since {why}")


@contextlib.contextmanager
def finished(
    call: Callable[[Item, str | None], Outcome],
    items: Sequence[Item],
    *,
    jobs: int,
    dask: str | None = None,
    scratch: str | None = None,
) -> Iterator[Iterator[Outcome]]:
    """Yield an iterator over the results of a call of every item in the order in which they finish.

    Leaving the block ends all work. The calls, which get an item and a folder for temporary files, run in `jobs`
    processes (in this one if there is one job), or on the workers of a Dask scheduler, which need this software.
    InputError if `jobs` is impossible, Dask is not installed, or the scheduler does not answer.
    """
    check_jobs(jobs)
    if not items:
        yield iter(())
    elif dask is not None:
        with _on_cluster(call, items, dask) as results:
            yield results
    elif jobs == 1 or len(items) == 1:
        yield (call(item, scratch) for item in items)
    else:
        with _in_processes(call, items, jobs, scratch) as results:
            yield results


@contextlib.contextmanager
def _in_processes(
    call: Callable[[Item, str | None], Outcome], items: Sequence[Item], jobs: int, scratch: str | None
) -> Iterator[Iterator[Outcome]]:
    import joblib
    from joblib.externals.loky import get_reusable_executor

    parallel = joblib.Parallel(
        n_jobs=min(jobs, len(items)), return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs"
    )
    with (
        _told(),
        # owned by this process: workers that are ended within a call leave their files behind
        tempfile.TemporaryDirectory(prefix="gyrowheel-", dir=scratch) as place,
        _ended(get_reusable_executor),
        joblib.parallel_config("loky", inner_max_num_threads=1),
        warnings.catch_warnings(),
    ):
        # one that has grown is replaced by a new one, which takes over its jobs
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")
        # the workers inherit the blocked signal: Ctrl-C reaches this process alone, which then ends them
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            results = parallel(joblib.delayed(_one)(call, item, place, os.getpid()) for item in items)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        try:
            yield results
        finally:
            with warnings.catch_warnings():
                # an error or the user has ended the work: its results are not used
                warnings.simplefilter("ignore")
                results.close()


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


def _one(call: Callable[[Item, str | None], Outcome], item: Item, scratch: str, parent: int) -> Outcome:
    """Make a call in a worker of the process of this number."""
    end_with(parent)  # a worker of a process that is killed must not go on alone
    return call(item, scratch)


@contextlib.contextmanager
def _ended(executor: Any) -> Iterator[None]:
    """Kill the workers at the end of the block."""
    try:
        yield
    finally:
        executor().shutdown(wait=True, kill_workers=True)


@contextlib.contextmanager
def _on_cluster(
    call: Callable[[Item, str | None], Outcome], items: Sequence[Item], address: str
) -> Iterator[Iterator[Outcome]]:
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
        # pure=False: two runs on one cluster must not share results
        futures = client.map(call, items, [None] * len(items), pure=False, retries=1)
        try:
            yield (future.result() for future in as_completed(futures, loop=client.loop))
        finally:
            client.cancel(futures)
