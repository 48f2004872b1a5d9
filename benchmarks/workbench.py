"""The workbench in a browser: opening and zooming an hour, compared with plotly-resampler; delay of a diagnosis.

``python -m benchmarks.workbench FOLDER`` serves the workbench like the command line, and prints its address and the
time at which a diagnosis was computed. The peer runs in a separate environment, which is created for the measurement
and removed afterwards.

Memory of the machine is touched right before both load the hour, by a process that then ends. The host of a virtual
machine may take freed memory back, and needs seconds for a gigabyte when it is used again: that would be a figure of
the host. The notes state how long it took.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import venv
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.diagnosis import HOUR, MINUTES, plan, record
from benchmarks.results import Bar, Figure, MeasurementError, Report

PEER = "plotly-resampler"
#: Packages of the peer's environment.
_PEER_PACKAGES = ("plotly-resampler==0.11.1",)
_POINTS = 2000  # per line, for both
_PATIENCE = 600.0  # s
_LISTED = 500  # recordings in the list
_TOUCHED = 4  # GB of memory before an opening, several times what it needs
_OPENINGS = 3  # of the hour, by either
_TOUCH = """
import sys
import time

import numpy as np

began = time.perf_counter()
np.empty(int(sys.argv[1]) * 125_000_000).fill(1.0)
print(time.perf_counter() - began)
"""
#: Parts of the recording that are shown in turn: middle and width, as fractions of its length.
_ZOOMS = tuple(
    (0.2 + 0.6 * (7 * k % 10) / 10, width)
    for k, width in enumerate(
        (0.5, 0.2, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 0.7, 0.15, 5e-3, 5e-4, 1.0)
    )
)
#: Lines that both draw, panel by panel.
_LINES = (
    ("tilt_x", "tilt_y"),
    ("spin_rate",),
    ("coil_voltage_x", "coil_voltage_y"),
    ("motor_voltage",),
    ("motor_current",),
)
_TWO_FRAMES = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
_ZOOM = """async ([from, until]) => {
  const { zoom } = await import("/files/signals.js");
  const began = performance.now();
  await zoom(from, until);
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  return performance.now() - began;
}"""
_PEER_ZOOM = """async ([from, until]) => {
  const plot = document.querySelector(".js-plotly-plot");
  const before = plot.data[0].x;
  const drawn = new Promise((done) => plot.on("plotly_afterplot", () => plot.data[0].x !== before && done()));
  const axes = Object.keys(plot._fullLayout).filter((name) => /^xaxis\\d*$/.test(name));
  const began = performance.now();
  const ends = (name) => [[`${name}.range[0]`, from], [`${name}.range[1]`, until]];
  Plotly.relayout(plot, Object.fromEntries(axes.flatMap(ends)));
  await drawn;
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  plot.removeAllListeners("plotly_afterplot");
  return performance.now() - began;
}"""
#: Time [ms since 1970] of the second frame after a verdict is on the page.
_SHOWN = """() => new Promise((done) => {
  const seen = () => {
    if (!document.querySelector("[data-verdict]")) return;
    watcher.disconnect();
    requestAnimationFrame(() => requestAnimationFrame(() => done(Date.now())));
  };
  const watcher = new MutationObserver(seen);
  watcher.observe(document.body, { childList: true, subtree: true });
  seen();
})"""
_PEER_SERVER = """
import sys

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from plotly_resampler import FigureResampler

folder, port, points, *panels = sys.argv[1:]
print("loaded: libraries", flush=True)
input()
time = np.load(f"{folder}/time.npy")
figure = FigureResampler(
    make_subplots(rows=len(panels), shared_xaxes=True, vertical_spacing=0.02), default_n_shown_samples=int(points)
)
for row, names in enumerate(panels, 1):
    for name in names.split(","):
        figure.add_trace(go.Scattergl(name=name), hf_x=time, hf_y=np.load(f"{folder}/{name}.npy"), row=row, col=1)
figure.update_layout(height=735)
figure.show_dash(mode="external", port=int(port), host="127.0.0.1")
"""


def measure(progress: Callable[[float], None]) -> list[Report]:
    """Measure an hour with the peer, and a diagnosis of a recording of four minutes."""
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        return measured(Path(name), (HOUR, MINUTES), progress)


def measured(folder: Path, lengths: tuple[str, str], progress: Callable[[float], None]) -> list[Report]:
    """Measure with recordings of two lengths, the first for viewing, the second for a diagnosis.

    Raises
    ------
    MeasurementError
        If there is no browser, or a server does not answer.
    """
    for part, length in enumerate(lengths):
        place = folder / f"run{part}" / "run"
        if not place.exists():
            record(place, plan(length), lambda done, part=part: progress(0.3 * part + 0.3 * done))  # type: ignore[misc]
    with browser() as window:
        ours = _look(folder / "run0", window, progress)
        shown = _diagnosis(folder / "run1", window)
        listed = _listed(folder / "run1" / "run", window)
        progress(0.85)
        peer = _peer(folder / "run0" / "run", window)
    return [_report(lengths, ours, {"shown": shown, "listed": listed}, peer)]


def _report(
    lengths: tuple[str, str], ours: dict[str, Any], page: dict[str, float], peer: dict[str, Any] | str
) -> Report:
    other: dict[str, Any] = peer if isinstance(peer, dict) else {}

    def peer_of(name: str) -> dict[str, Any]:
        return {"peer": PEER, "peer_value": other[name]} if other else {}

    notes = [
        f"{lengths[0]}, {ours['samples'] / 1e6:.2g} million samples, seven lines in five panels, at most {_POINTS}"
        " points a line, in Chromium. Opening: from the click to the second frame after the lines are there; of the"
        f" peer, which is given the samples as arrays, from the start of its process; median of {_OPENINGS}. Zoom:"
        " from the change of the span to the second frame after the new points are there,"
        f" {len(_ZOOMS)} spans from all of it to a 30 000th."
        " Memory: the most that the server had by then.",
        f"Right before either loads the hour, {_TOUCHED} GB of memory are touched, which does not count. A GB took the"
        f" first time and the second: {' and '.join(_times(own['touched']) for own in (ours, other) if own)}.",
        f"Diagnosis: {lengths[1]}, from its end in the server to the second frame with the verdict on the page."
        f" Recordings in folders: from the call of the page to the second frame with {_LISTED}, median of five pages.",
        f"Load average {os.getloadavg()[1]:.1f} on {os.cpu_count()} cores.",
    ]
    if not other:
        notes.append(f"{PEER} was not measured: {peer}")
    return Report(
        "Workbench",
        [
            Figure("opening", ours["opening"], "s", **peer_of("opening"), bar=Bar("<", 3.0)),
            Figure("zoom, median", ours["median"], "ms", **peer_of("median"), bar=Bar("<", 150.0)),
            Figure("zoom, worst", ours["worst"], "ms", **peer_of("worst"), bar=Bar("<", 600.0)),
            Figure("bytes of a zoom, median", ours["bytes"], "kB", **peer_of("bytes")),
            Figure("memory", ours["memory"], "GB", **peer_of("memory"), bar=Bar("<", 2.0)),
            Figure("memory, compared with a model too", ours["compared"], "GB"),
            Figure("memory, kept after the comparison", ours["kept"], "GB"),
            Figure("diagnosis shown after", page["shown"], "s", bar=Bar("<", 1.0)),
            Figure(f"{_LISTED} recordings listed", page["listed"], "s", bar=Bar("<", 1.0)),
        ],
        notes=notes,
    )


def _times(touched: tuple[float, float]) -> str:
    return ", ".join(f"{seconds:.2f}" for seconds in touched) + " s"


def _touch() -> tuple[float, float]:
    """Touch memory of the machine twice; return how long a gigabyte took each time [s]."""
    command = [sys.executable, "-c", _TOUCH, str(_TOUCHED)]
    first, second = (
        float(subprocess.run(command, capture_output=True, text=True, check=True).stdout) / _TOUCHED
        for _ in range(2)
    )
    return first, second


@dataclass(frozen=True)
class _Opened:
    """A page with an hour on it: server, time from the click to the drawn lines [s], times of memory (`_touch`)."""

    process: subprocess.Popen[str]
    page: Any
    seconds: float
    touched: tuple[float, float]


@contextmanager
def _opened(folder: Path, window: Any) -> Iterator[_Opened]:
    """Open a recording in a new workbench."""
    with serving([sys.executable, "-m", "benchmarks.workbench", str(folder)]) as (process, lines):
        page = _page(window, lines.after("page: "))
        touched = _touch()
        began = time.perf_counter()
        page.locator("button[data-do=open]").first.click()
        page.wait_for_selector("#plots[data-drawn]", timeout=1e3 * _PATIENCE)
        page.evaluate(_TWO_FRAMES)
        yield _Opened(process, page, time.perf_counter() - began, touched)
        page.close()


def _first_openings(opened: Callable[[], AbstractContextManager[_Opened]]) -> list[float]:
    """Return the times of all openings but the last, whose page is used further."""
    times = []
    for _ in range(_OPENINGS - 1):
        with opened() as own:
            times.append(own.seconds)
    return times


def _look(folder: Path, window: Any, progress: Callable[[float], None]) -> dict[str, Any]:
    """Open a recording in the workbench and zoom into parts of it."""
    from playwright.sync_api import expect

    times = _first_openings(lambda: _opened(folder, window))
    with _opened(folder, window) as own:
        process, page = own.process, own.page
        samples, end = page.evaluate(
            "import('/files/signals.js').then(({ shown }) => [shown().samples, shown().duration])"
        )
        found = _zooms(page, lambda span: page.evaluate(_ZOOM, span), end, "/signal")
        memory = _most_memory(process.pid)
        progress(0.7)
        page.locator("#steps [data-step=what]").click()
        page.locator("button[data-do=compare]").click()
        page.locator("#steps [data-step=where]").click()
        page.wait_for_selector("#where canvas", timeout=1e3 * _PATIENCE)
        expect(page.locator("#job button")).to_have_count(0, timeout=1e3 * _PATIENCE)
        compared = _most_memory(process.pid)
        page.wait_for_timeout(1000.0)  # until freed memory is returned
        kept = resident_memory(process.pid)
    progress(0.8)
    memories = {"memory": memory, "compared": compared, "kept": kept}
    opening = {"opening": median([*times, own.seconds]), "touched": own.touched}
    return found | memories | opening | {"samples": samples}


def _listed(recording: Path, window: Any) -> float:
    """Return the time from the call of the page to the second frame with many recordings in the list [s]."""
    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        for k in range(_LISTED):
            place = Path(name) / f"day{k // 20}" / f"run{k}"
            place.mkdir(parents=True)
            shutil.copy(recording / "metadata.yaml", place)
        with serving([sys.executable, "-m", "benchmarks.workbench", name]) as (_, lines):
            url = lines.after("page: ")
            took = []
            for _ in range(5):
                page = window.new_page(viewport={"width": 1400, "height": 1000})
                began = time.perf_counter()
                page.goto(url, wait_until="commit")
                page.wait_for_function(
                    "(least) => document.querySelectorAll('#part-recordings li').length >= least", arg=_LISTED
                )
                page.evaluate(_TWO_FRAMES)
                took.append(time.perf_counter() - began)
                page.close()
            return median(took)


def _diagnosis(folder: Path, window: Any) -> float:
    """Return the delay from the end of a diagnosis to its display [s]."""
    with serving([sys.executable, "-m", "benchmarks.workbench", str(folder)]) as (_, lines):
        page = _page(window, lines.after("page: "))
        page.locator("button[data-do=open]").first.click()
        page.wait_for_selector("#plots[data-drawn]", timeout=1e3 * _PATIENCE)
        page.locator("#part-verdict button[data-do=diagnose]").click()
        seen = page.evaluate(_SHOWN)
        page.close()
        return 1e-3 * seen - float(lines.after("diagnosed: "))


def _peer(recording: Path, window: Any) -> dict[str, Any] | str:
    """Return the figures of the peer for the same samples; the reason if it cannot be installed."""
    from gyrowheel_recording.bags import Recording

    with tempfile.TemporaryDirectory(prefix="gyrowheel-bench-") as name:
        place = Path(name)
        venv.create(place / "venv", with_pip=True)
        python = place / "venv" / "bin" / "python"
        done = subprocess.run(
            [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *_PEER_PACKAGES],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            return " ".join(done.stderr.split())[-300:]
        data = Recording.open(recording)
        np.save(place / "time.npy", data.time)
        for names in _LINES:
            for line in names:
                np.save(place / f"{line}.npy", data.measurement[line])
        end = data.duration
        del data
        (place / "server.py").write_text(_PEER_SERVER, encoding="utf-8")
        command = [str(python), str(place / "server.py"), name]
        times = _first_openings(lambda: _peer_opened(command, window))
        with _peer_opened(command, window) as own:
            page = own.page
            page.wait_for_timeout(3000.0)  # it draws some time before it reacts to a zoom
            found = _zooms(page, lambda span: page.evaluate(_PEER_ZOOM, span), end, "_dash-update-component")
            opening = {"opening": median([*times, own.seconds]), "touched": own.touched}
            return found | opening | {"memory": _most_memory(own.process.pid)}


@contextmanager
def _peer_opened(command: list[str], window: Any) -> Iterator[_Opened]:
    """Open the arrays in a new server of the peer."""
    port = _free_port()
    began = time.perf_counter()
    with serving([*command, str(port), str(_POINTS), *map(",".join, _LINES)]) as (process, lines):
        lines.after("loaded: ")
        loaded = time.perf_counter() - began
        touched = _touch()
        began = time.perf_counter() - loaded
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
        _await_port(port)
        page = _page(window, f"http://127.0.0.1:{port}/")
        page.wait_for_function(
            "document.querySelector('.js-plotly-plot')?.data?.length > 0", timeout=1e3 * _PATIENCE
        )
        page.evaluate(_TWO_FRAMES)
        yield _Opened(process, page, time.perf_counter() - began, touched)
        page.close()


def _zooms(page: Any, zoom: Callable[[list[float]], float], end: float, answer: str) -> dict[str, float]:
    sizes: list[int] = []
    page.on("response", lambda own: sizes.append(len(own.body())) if answer in own.url else None)
    took = []
    for middle, width in _ZOOMS:
        span = [max(end * (middle - 0.5 * width), 0.0), min(end * (middle + 0.5 * width), end)]
        took.append(zoom(span))
        page.wait_for_timeout(150.0)  # late work of a zoom does not count for the next one
    return {"median": median(took), "worst": max(took), "bytes": 1e-3 * median(sizes) if sizes else 0.0}


def _page(window: Any, address: str) -> Any:
    page = window.new_page(viewport={"width": 1400, "height": 1000})
    page.set_default_timeout(1e3 * _PATIENCE)
    page.goto(address)
    return page


@contextmanager
def browser() -> Iterator[Any]:
    """Yield a headless browser; MeasurementError if none is installed."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium")
    if chromium is None:
        raise MeasurementError("needs Chromium, which is not installed")
    with sync_playwright() as play:
        window = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield window
        window.close()


class _Lines:
    """The output lines of a process, in order."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._lines: list[str] = []
        self._said = threading.Condition()
        self._ended = False
        self._process = process
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._said:
                self._lines.append(line)
                self._said.notify_all()
        with self._said:
            self._ended = True
            self._said.notify_all()

    def after(self, mark: str) -> str:
        """Wait for a line with a mark and return the text after the mark."""

        def found() -> str | None:
            return next((line.partition(mark)[2].strip() for line in self._lines if mark in line), None)

        with self._said:
            self._said.wait_for(lambda: self._ended or found() is not None, _PATIENCE)
            text = found()
        if text is None:
            raise MeasurementError(
                f"no line with '{mark.strip()}': {' '.join(''.join(self._lines).split())[-300:]}"
            )
        return text


@contextmanager
def serving(
    command: list[str], environment: Mapping[str, str] = MappingProxyType({})
) -> Iterator[tuple[subprocess.Popen[str], _Lines]]:
    """Run a server during a block; yield its process and its lines."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, **environment, "PYTHONUNBUFFERED": "1", "NO_COLOR": "1"},
    )
    try:
        yield process, _Lines(process)
    finally:
        process.kill()
        process.wait()


def _free_port() -> int:
    import socket

    with socket.socket() as own:
        own.bind(("127.0.0.1", 0))
        return int(own.getsockname()[1])


def _await_port(port: int) -> None:
    """Wait until a server answers at a port."""
    import socket

    end = time.monotonic() + _PATIENCE
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            if time.monotonic() > end:
                raise MeasurementError(f"{PEER} does not answer") from None
            time.sleep(0.02)
        else:
            return


def resident_memory(pid: int, which: str = "VmRSS") -> float:
    """Return the memory of a process [GB]: now, or by the name of another figure of its status."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    return 1.024e-6 * float(next(line.split()[1] for line in status.splitlines() if line.startswith(which)))


def _most_memory(pid: int) -> float:
    """Return the peak memory of a process [GB]."""
    return resident_memory(pid, "VmHWM")


def serve(folder: str) -> None:
    """Serve the workbench on recordings of a folder, and print its address and the time of a diagnosis."""
    from gyrowheel.models.api import Model
    from gyrowheel.workbench import session
    from gyrowheel.workbench.library import Library
    from gyrowheel.workbench.server import Server

    name = "diagnose"
    computed = getattr(session, name)

    def diagnose(*given: Any, **named: Any) -> Any:
        found = computed(*given, **named)
        sys.stdout.write(f"diagnosed: {time.time():.6f}\n")
        return found

    setattr(session, name, diagnose)
    with Server(session.Session(Library([Path(folder)]), Model()), port=0) as own:
        sys.stdout.write(f"page: {own.url}\n")
        threading.Event().wait()


if __name__ == "__main__":
    serve(sys.argv[1])
