"""The live pane of the workbench next to a bench in real time: frames, memory of the browser, pace of the graph."""

from __future__ import annotations

import itertools
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.graph import PLAN
from benchmarks.realtime import WATCHDOG_S
from benchmarks.results import Bar, Figure, MeasurementError, Report
from benchmarks.timing import processor_time
from benchmarks.workbench import browser, serving
from gyrowheel_bringup.graph import Graph, Progress
from gyrowheel_core.node import prepare_environment

MINUTES = 10.0
_DOMAIN = 63
_BEGUN_S = 5.0  # of a span that do not count: the page is opening
_PATIENCE = 120.0  # s
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
    memory: list[tuple[float, float]] = field(default_factory=list)  # heap of scripts, whole page [MB]

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
    heaps, pages = zip(*watched.memory, strict=True)
    third = max(len(heaps) // 3, 1)

    def growth(sizes: Sequence[float]) -> float:
        return 100.0 * (median(sizes[-third:]) / median(sizes[:third]) - 1.0)

    return Report(
        "Live pane",
        [
            Figure("frames", watched.frames, "1/s", bar=Bar(">=", 25.0)),
            Figure("samples received", 100.0 * watched.received, "%", bar=Bar(">=", 99.0)),
            Figure("memory of the page", median(pages), "MB"),
            Figure("growth: memory of the page", growth(pages), "%", bar=Bar("<", 10.0)),
            Figure("growth: heap of its scripts", growth(heaps), "%", bar=Bar("<", 10.0)),
            figure("graph in real time", real, 0, Bar(">=", 0.97, "ratio")),
            figure("processor time of its nodes", real, 1),
            figure("graph in lock-step", steps, 0),
        ],
        notes=[
            f"Whole graph and page on one computer, load average {os.getloadavg()[2]:.1f} on {os.cpu_count()} cores. "
            f"In real time: 2 kHz, {watched.seconds / 60.0:g} min watched, a minute without before and after. Graph: "
            "simulated over wall time. Memory: private memory of the process of the page, and its heap after a "
            "collection, every 20 s; growth from the first third to the last. In lock-step, where nodes, server and "
            "browser share the cores: by turns of 25 s.",
        ],
    )


def _run(spans: Sequence[_Span], progress: Callable[[float], None], *, realtime: bool) -> None:
    """Run a graph, and a page next to it in turn."""
    now, over, failed = [spans[0]], threading.Event(), []
    whole = sum(own.seconds for own in spans)

    def look() -> None:
        try:
            _look(spans, now)
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
            threading.Thread(target=look, daemon=True).start()
            graph.run(progress=note)
    except _Over:
        pass
    if failed:
        raise MeasurementError(f"page: {failed[0]}")


def _look(spans: Sequence[_Span], now: list[_Span]) -> None:
    environment = {"ROS_DOMAIN_ID": str(_DOMAIN)}
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as folder:
        command = [
            sys.executable,
            "-c",
            "from gyrowheel.cli.app import main; main()",
            "workbench",
            folder,
            "--port",
            "0",
        ]
        with serving(command, environment) as (_, lines), browser() as window:
            url = lines.after("page: ")
            for own in spans:
                now[0] = own
                if own.watched:
                    _watch(window, url, own)
                else:
                    time.sleep(own.seconds)


def _watch(window: Any, url: str, own: _Span) -> None:
    page = window.new_page(viewport={"width": 1400, "height": 900})
    page.set_default_timeout(1e3 * _PATIENCE)
    page.goto(url)
    page.locator("#part-live [data-watch]").first.click()
    page.wait_for_function("async () => (await import('/files/live.js')).seen.frames > 30")
    inspector = page.context.new_cdp_session(page)
    whole = window.new_browser_cdp_session()
    began, (frames, bins) = time.monotonic(), page.evaluate(_SEEN)
    simulated = own.marks[-1][1] if own.marks else 0.0
    for k in itertools.count(1):
        page.wait_for_timeout(max(1e3 * (began + 20.0 * k - time.monotonic()), 1.0))
        inspector.send("HeapProfiler.collectGarbage")
        heap = inspector.send("Runtime.getHeapUsage")["usedSize"]
        own.memory.append((1e-6 * heap, _private(whole)))
        if time.monotonic() - began >= own.seconds:
            break
    now = page.evaluate(_SEEN)
    own.frames = (now[0] - frames) / (time.monotonic() - began)
    own.received = 0.01 * (now[1] - bins) / (own.marks[-1][1] - simulated)
    page.close()


def _private(whole: Any) -> float:
    """Return the private memory of the largest process of a page [MB]."""
    pids = [
        own["id"]
        for own in whole.send("SystemInfo.getProcessInfo")["processInfo"]
        if own["type"] == "renderer"
    ]
    sizes = []
    for pid in pids:
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
        sizes += [float(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon")]
    return 1.024e-3 * max(sizes)
