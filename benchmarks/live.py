"""The live pane of the workbench next to a bench in real time: frames, memory of the browser, pace of the graph.

The browser is one that no test tool drives: such a tool keeps what the page receives, which then counts as its memory.
A question is asked through a connection that lasts for this question.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any
from urllib.request import Request, urlopen

from benchmarks.graph import PLAN
from benchmarks.realtime import WATCHDOG_S
from benchmarks.results import Bar, Figure, MeasurementError, Report
from benchmarks.timing import processor_time
from benchmarks.workbench import serving
from gyrowheel_bringup.graph import Graph, Progress
from gyrowheel_core.node import prepare_environment

MINUTES = 10.0
_DOMAIN = 63
_BEGUN_S = 5.0  # of a span that do not count: the page is opening
_PATIENCE = 120.0  # s
_SETTLED_S = 90.0  # of the first look at the memory: until then the page fills its minute of samples
_PACE_S = 5.0  # between two readings of the memory
_SEEN = "import('/files/live.js').then(({ seen }) => [seen.frames, seen.bins])"


@dataclass
class _Span:
    """A span of time, with or without a page that watches."""

    watched: bool
    seconds: float
    #: By progress of the plan: wall time, simulated time, processor time of the nodes [s].
    marks: list[tuple[float, float, float]] = field(default_factory=list)
    frames: float = float("nan")  # per second
    received: float = float("nan")  # of the samples
    #: Heap of the scripts, process of the page, browser; at the first look and at the end, after a collection [MB].
    kept: list[tuple[float, float, float]] = field(default_factory=list)
    most: float = 0.0  # of the process of the page, with what is not collected yet [MB]

    def slopes(self) -> tuple[float, float]:
        """Return simulated and processor time per wall time."""
        (t0, s0, c0), *_ = some = [own for own in self.marks if own[0] - self.marks[0][0] > _BEGUN_S]
        t1, s1, c1 = some[-1]
        return (s1 - s0) / (t1 - t0), (c1 - c0) / (t1 - t0)


class _Over(Exception):
    """All spans are measured."""


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure ten watched minutes in real time, and minutes without a page; then the lock-step, by turns."""
    prepare_environment()
    real = [_Span(False, 60.0), _Span(True, 60.0 * MINUTES), _Span(False, 60.0)]
    steps = [_Span(k % 2 == 1, 25.0) for k in range(7)]
    _run(real, lambda done: progress(0.8 * done), realtime=True)
    _run(steps, lambda done: progress(0.8 + 0.2 * done), realtime=False)
    return [_report(real, steps)]


def _report(real: Sequence[_Span], steps: Sequence[_Span]) -> Report:
    def pace(spans: Sequence[_Span], place: int, *, watched: bool) -> float:
        return median(own.slopes()[place] for own in spans if own.watched is watched)

    def figure(name: str, spans: Sequence[_Span], place: int, bar: Bar | None = None) -> Figure:
        values = (pace(spans, place, watched=watched) for watched in (True, False))
        return Figure(name, next(values), "s/s", "not watched", next(values), bar)

    watched = next(own for own in real if own.watched)
    first, last = watched.kept
    growth = [100.0 * (after / before - 1.0) for before, after in zip(first, last, strict=True)]
    flat = Bar("<", 10.0)
    return Report(
        "Live pane",
        [
            Figure("frames", watched.frames, "1/s", bar=Bar(">=", 25.0)),
            Figure("samples received", 100.0 * watched.received, "%", bar=Bar(">=", 99.0)),
            Figure("memory of the page", last[1], "MB"),
            Figure("growth: memory of the page", growth[1], "%", bar=flat),
            Figure("growth: memory of the browser", growth[2], "%", bar=flat),
            Figure("growth: heap of its scripts", growth[0], "%", bar=flat),
            Figure("memory of the page, most", watched.most, "MB"),
            figure("graph in real time", real, 0, Bar(">=", 0.97, "ratio")),
            figure("processor time of its nodes", real, 1),
            figure("graph in lock-step", steps, 0),
        ],
        notes=[
            f"Whole graph and page on one computer, load average {os.getloadavg()[2]:.1f} on {os.cpu_count()} cores. "
            f"In real time: 2 kHz, {watched.seconds / 60.0:g} min watched, a minute without before and after. Graph: "
            "simulated over wall time. Memory: private memory of the process of the page, and of all processes of the "
            f"browser, after a collection, {_SETTLED_S:g} s after the first pictures and at the end; the most of the "
            f"page, every {_PACE_S:g} s, with what is not collected yet. No tool is connected to it meanwhile. "
            "In lock-step, where nodes, server and browser share the cores: by turns of 25 s.",
        ],
    )


def _run(spans: Sequence[_Span], progress: Callable[[float], None], *, realtime: bool) -> None:
    """Run a graph, and a page next to it in turn."""
    now, over, ended, failed = [spans[0]], threading.Event(), threading.Event(), []
    whole = sum(own.seconds for own in spans)

    def look() -> None:
        try:
            _look(spans, now, ended)
        except Exception as error:  # shown by the thread that measures
            failed.append(error)
        over.set()

    def note(at: Progress) -> None:
        cost = sum(map(processor_time, graph.pids.values()))
        now[0].marks.append((time.monotonic(), at.elapsed, cost))
        progress(min((time.monotonic() - began) / whole, 1.0))
        if over.is_set():
            raise _Over

    began = time.monotonic()
    try:
        with Graph(
            PLAN.replace("REPEAT", "1000"),
            realtime=realtime,
            parameters={"plant": {"watchdog": WATCHDOG_S}},
            domain_id=_DOMAIN,
        ) as graph:
            looks = threading.Thread(target=look)
            looks.start()
            try:
                graph.run(progress=note)
            finally:  # server and browser end with the graph
                ended.set()
                looks.join()
    except _Over:
        pass
    if failed:
        raise MeasurementError(f"page: {failed[0]}")


def _look(spans: Sequence[_Span], now: list[_Span], ended: threading.Event) -> None:
    environment = {"ROS_DOMAIN_ID": str(_DOMAIN)}
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-", ignore_cleanup_errors=True) as folder:
        command = [
            sys.executable,
            "-c",
            "from gyrowheel.cli.app import main; main()",
            "workbench",
            folder,
            "--port",
            "0",
        ]
        with serving(command, environment) as (_, lines), _browser(Path(folder)) as browser:
            url = lines.after("page: ")
            for own in spans:
                now[0] = own
                if own.watched:
                    _watch(browser, url, own, ended)
                elif ended.wait(own.seconds):
                    return


def _watch(browser: _Browser, url: str, own: _Span, ended: threading.Event) -> None:
    page = browser.open(url)
    page.await_true("document.querySelector('#part-live [data-watch]')")
    page.value("document.querySelector('#part-live [data-watch]').click()")
    page.await_true(f"{_SEEN}.then(([frames]) => frames > 30)")
    began, (frames, bins) = time.monotonic(), page.value(_SEEN)
    simulated = own.marks[-1][1] if own.marks else 0.0
    while (since := time.monotonic() - began) < own.seconds:
        if since >= _SETTLED_S and not own.kept:
            own.kept.append((page.heap(), *browser.memory()))
        own.most = max(own.most, browser.memory()[0])
        if ended.wait(_PACE_S):
            return
    now = page.value(_SEEN)
    own.frames = (now[0] - frames) / (time.monotonic() - began)
    own.received = 0.01 * (now[1] - bins) / (own.marks[-1][1] - simulated)
    own.kept.append((page.heap(), *browser.memory()))
    page.close()


@contextmanager
def _browser(folder: Path) -> Iterator[_Browser]:
    """Run a headless browser that no tool drives; MeasurementError if none is installed."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise MeasurementError("needs Chromium, which is not installed")
    options = ["--headless", "--no-sandbox", "--remote-debugging-port=0", "--window-size=1400,900"]
    profile = f"--user-data-dir={folder / 'profile'}"
    with serving([chromium, *options, profile, "about:blank"]) as (process, lines):
        yield _Browser(process.pid, lines.after("DevTools listening on ws://").partition("/")[0])


@dataclass(frozen=True)
class _Browser:
    """A browser: its first process, and the address where it answers."""

    pid: int
    address: str

    def open(self, url: str) -> _Page:
        """Open a page."""
        with urlopen(Request(f"http://{self.address}/json/new?{url}", method="PUT")) as answer:
            content = json.load(answer)
        return _Page(self.address, content["id"], content["webSocketDebuggerUrl"])

    def memory(self) -> tuple[float, float]:
        """Return the private memory of the largest process of a page, and of the whole browser [MB]."""
        of_pages, all_of = [0.0], 0.0
        for pid in _descendants(self.pid):
            try:
                size = _private(pid)
                command = Path(f"/proc/{pid}/cmdline").read_bytes()
            except (OSError, ValueError):
                continue  # it has ended
            all_of += size
            if b"--type=renderer" in command:
                of_pages.append(size)
        return max(of_pages), all_of


@dataclass(frozen=True)
class _Page:
    """A page of a browser; every question has its own connection, so that nothing is kept for it."""

    address: str
    name: str
    link: str

    def ask(self, method: str, **given: Any) -> dict[str, Any]:
        """Return the answer of the page."""
        return asyncio.run(self._ask(method, given))

    async def _ask(self, method: str, given: dict[str, Any]) -> dict[str, Any]:
        from tornado.websocket import websocket_connect

        link = await websocket_connect(self.link, connect_timeout=_PATIENCE)
        try:
            await link.write_message(json.dumps({"id": 1, "method": method, "params": given}))
            while (said := await asyncio.wait_for(link.read_message(), _PATIENCE)) is not None:
                answer = json.loads(said)
                if answer.get("id") == 1:
                    return dict(answer["result"])
        finally:
            link.close()
        raise MeasurementError(f"{method}: the page is gone")

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        found = self.ask("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        return found["result"].get("value")

    def await_true(self, expression: str) -> None:
        """Wait until an expression is true."""
        until = time.monotonic() + _PATIENCE
        while not self.value(f"Promise.resolve({expression}).then(Boolean)"):
            if time.monotonic() > until:
                raise MeasurementError(f"never true: {expression}")
            time.sleep(0.5)

    def heap(self) -> float:
        """Return the size of the heap of the scripts after a collection [MB]."""
        self.ask("HeapProfiler.collectGarbage")
        return 1e-6 * float(self.ask("Runtime.getHeapUsage")["usedSize"])

    def close(self) -> None:
        """Close the page."""
        with urlopen(f"http://{self.address}/json/close/{self.name}"):
            pass


def _descendants(pid: int) -> list[int]:
    """Return a process and all below it."""
    found = [pid]
    for own in found:
        for thread in Path(f"/proc/{own}/task").glob("*/children"):
            try:
                found += map(int, thread.read_text(encoding="ascii").split())
            except OSError:
                continue  # it has ended
    return found


def _private(pid: int) -> float:
    """Return the private memory of a process [MB]."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    return 1.024e-3 * sum(
        float(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon")
    )
