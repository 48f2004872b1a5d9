"""The workbench under load: jobs, saves while another process holds the model, idle connections; how it answers."""

from __future__ import annotations

import contextlib
import http.client
import itertools
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any
from urllib.parse import urlsplit

from benchmarks.diagnosis import record
from benchmarks.results import Bar, Figure, MeasurementError, Report
from benchmarks.workbench import resident_memory, serving
from gyrowheel import Model

JOBS = 200
SAVES = 20
CONNECTIONS = 300
SECONDS = 600.0  # for all of it
PLAN = """\
schema: 1
name: drag
hold_s: 1.3
segments:
  - {spin_rpm: 3500, tilt_deg: [[0, 0], [3, 0], [0, 3]]}
  - {spin_rpm: 2500, tilt_deg: [[-3, 0], [0, -3]]}
  - {spin_rpm: 1500, tilt_deg: [[0, 0], [2, 2], [0, 3]]}
"""
_PAGES = ("/", "/state", "/found", "/help")
_PAUSE = 0.05  # s between two requests
_HELD = 2.0  # s for which another process holds the model
_HOLDS = """
import sys
from pathlib import Path
from gyrowheel_core.locks import changing
for line in sys.stdin:
    with changing(Path(sys.argv[1])):
        print("held", flush=True)
        sys.stdin.readline()
"""
#: What the jobs are, in turn; the use of the recording alternates, so that each comparison is another one.
_TURN: tuple[tuple[str, dict[str, str]], ...] = (
    ("open", {"key": "0/run", "role": "fitted"}),
    ("compare", {}),
    ("diagnose", {}),
    ("open", {"key": "0/run", "role": "not used to fit"}),
    ("compare", {}),
)


class _Client:
    """Asks the server, and keeps the time of every answer."""

    def __init__(self, url: str) -> None:
        self._address = urlsplit(url)
        self.took: list[float] = []
        self.statuses: Counter[int] = Counter()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        return str(self._address.hostname), int(self._address.port or 0)

    def ask(self, path: str, content: dict[str, str] | None = None) -> Any:
        """Return the body of an answer; of a request that is refused, None."""
        connection = http.client.HTTPConnection(*self.address, timeout=SECONDS)
        began = time.perf_counter()
        body = None if content is None else json.dumps(content)
        connection.request(
            "GET" if body is None else "POST", path, body, {"Content-Type": "application/json"}
        )
        answer = connection.getresponse()
        text = answer.read()
        self.took.append(time.perf_counter() - began)
        connection.close()
        self.statuses[answer.status] += 1
        return json.loads(text) if answer.status == 200 and path != "/" and path != "/help" else None

    def do(self, what: str, **content: str) -> str:
        """Do one job and return the error that it ends with; empty if it succeeds."""
        end = time.monotonic() + SECONDS
        self.ask(f"/do/{what}", content)
        while (state := self.ask("/state"))["job"] is not None:
            if time.monotonic() > end:
                raise MeasurementError(f"{what} does not end")
            time.sleep(_PAUSE)
        return "" if state["trouble"] is None else str(state["trouble"]["sentence"])


@contextlib.contextmanager
def _asked(client: _Client, failed: list[str]) -> Iterator[None]:
    """Request the pages in turn during a block."""
    over = threading.Event()

    def ask() -> None:
        for path in itertools.cycle(_PAGES):
            if over.wait(_PAUSE):
                break
            try:
                client.ask(path)
            except OSError as error:
                failed.append(f"{path}: {error}")

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextlib.contextmanager
def _held(model: Path) -> Iterator[Callable[[], None]]:
    """Provide a function that has another process hold a model for some seconds from now."""
    command = [sys.executable, "-c", _HOLDS, str(model)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdin is not None
        assert holder.stdout is not None
        write, read = holder.stdin, holder.stdout

        def line() -> None:
            write.write("\n")
            write.flush()

        def hold() -> None:
            line()
            if read.readline() != "held\n":
                raise MeasurementError("no other process holds the model")
            threading.Timer(_HELD, line).start()

        yield hold


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Run all jobs and saves, with the connections open from a quarter of them on."""
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name, contextlib.ExitStack() as open_:
        folder = Path(name)
        record(folder / "runs" / "run", PLAN, lambda done: None)
        model = folder / "model.yaml"
        Model("gyrowheel").save(model)
        command = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()", "workbench"]
        command += [str(folder / "runs"), "--model", str(model), "--port", "0"]
        process, lines = open_.enter_context(serving(command))
        client, others, failed = _Client(lines.after("page: ")), [], []  # type: ignore[var-annotated]
        hold = open_.enter_context(_held(model))
        open_.enter_context(_asked(client, failed))
        began, saves, first, jobs = time.monotonic(), 0, float("nan"), 0
        for jobs, (what, content) in enumerate(itertools.islice(itertools.cycle(_TURN), JOBS), 1):
            if time.monotonic() - began > SECONDS:
                break
            if error := client.do(what, **content):
                failed.append(f"{what}: {error}")
            if jobs % (JOBS // SAVES) == 0:
                if saves % 2:
                    hold()
                if error := client.do("save", name="model.yaml"):
                    failed.append(f"save: {error}")
                saves += 1
            if jobs == JOBS // 4:
                first = resident_memory(process.pid)
                for _ in range(CONNECTIONS):
                    others.append(open_.enter_context(socket.create_connection(client.address)))
            progress(jobs / JOBS)
        seconds = time.monotonic() - began
        last = resident_memory(process.pid)
        Model.load(model)
    refused = sum(count for status, count in client.statuses.items() if status != 200)
    return [
        Report(
            "Workbench under load",
            [
                Figure("jobs", jobs, "", bar=Bar(">=", JOBS)),
                Figure("saves, each second one while another process held the model", saves, ""),
                Figure("idle connections", len(others), ""),
                Figure("answers", len(client.took), ""),
                Figure(
                    "not answered, refused or ended with an error",
                    len(failed) + refused,
                    "",
                    bar=Bar("<=", 0),
                ),
                Figure("answer, median", 1e3 * median(client.took), "ms"),
                Figure("answer, worst", 1e3 * max(client.took), "ms", bar=Bar("<", 1000.0)),
                Figure("memory after a quarter of the jobs", first, "GB"),
                Figure("memory at the end", last, "GB"),
                Figure("growth of memory", 100.0 * (last / first - 1.0), "%", bar=Bar("<", 10.0)),
            ],
            notes=[
                f"Opening, comparing and diagnosing a recording of a few seconds in turn, in {seconds:.0f} s; after"
                f" each {JOBS // SAVES} jobs the model is saved. Meanwhile the page, its state, its results and its help are"
                f" requested every {1e3 * _PAUSE:.0f} ms; the idle connections are open from a quarter of the jobs on."
                f" Load average {os.getloadavg()[1]:.1f} on {os.cpu_count()} cores.",
                *failed[:5],
            ],
        )
    ]
