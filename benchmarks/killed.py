"""``kill -9`` at random instants of verbs that write: the old or the new result exists, and the next command works.

Each verb runs in a process that is forked from a fully loaded one, so that the instants fall into its work and not into
its start. It runs once without being killed, which gives its duration; after each kill the files are read; at the end
it runs once more.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from benchmarks.results import Bar, Figure, MeasurementError, Report
from gyrowheel import Model
from gyrowheel_core.errors import InputError
from gyrowheel_recording.bags import Recording, salvage

Fraction = Callable[[float], None]

COUNT = 100
WRITERS = 50
CASES = 2  # of the campaign
DOMAIN = 83  # of the graphs, unless the environment names one
PLAN = """\
schema: 1
name: short
hold_s: 1.2
segments:
  - {spin_rpm: 3000, tilt_deg: [[0, 0], [2, 0], [0, 2], [-2, 0]]}
  - {spin_rpm: 2900, tilt_deg: [[0, 0], [2, 0], [0, 2], [-2, 0]]}
"""
_TRIES = 3  # for an instant
_PATIENCE = 120.0  # s
_ZYGOTE = """
    import json, os, sys

    import gyrowheel as gw
    from gyrowheel.cli.app import app
    from gyrowheel.cli.console import run

    quick = gw.simulate(sys.argv[1], effects={"windage": {}})  # loads what is compiled
    gw.Model("gyrowheel").add("windage", fit=quick)
    print("ready", flush=True)
    def forked(arguments):
        child = os.fork()
        if not child:
            os.setsid()
            nowhere = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(nowhere, stream)
            os._exit(run(app, arguments))
        return child

    for line in sys.stdin:
        children = [forked(arguments) for arguments in json.loads(line)]
        print(*children, flush=True)
        print(*(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children), flush=True)
"""


@dataclass
class Verb:
    """A verb that writes.

    Attributes
    ----------
    name : str
        Name of the verb.
    arguments : list of str
        Arguments of the command line.
    prepare : callable
        Creates its initial files.
    check : callable
        Returns the fault of the files after a kill; empty if there is none.
    done : callable
        Returns whether its result exists.
    folder : Path
        Folder of its output.
    """

    name: str
    arguments: list[str]
    prepare: Callable[[], None]
    check: Callable[[], str]
    done: Callable[[], bool]
    folder: Path


@dataclass
class Kills:
    """Results of the kills of one verb.

    Attributes
    ----------
    instants : int
        Number of kills while it worked.
    before, after : int
        How often its result was missing, and present, after a kill.
    wrong : list of str
        Faults.
    """

    instants: int = 0
    before: int = 0
    after: int = 0
    wrong: list[str] = field(default_factory=list)


class Zygote:
    """A fully loaded process from which verbs are forked."""

    def __init__(self, folder: Path) -> None:
        plan = folder / "plan.yaml"
        plan.write_text(PLAN, encoding="utf-8")
        self._process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(_ZYGOTE), str(plan)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={"ROS_DOMAIN_ID": str(DOMAIN), **os.environ},
        )
        if self._line() != "ready":
            raise MeasurementError("the program does not load")

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def start(self, *verbs: list[str]) -> list[int]:
        """Start verbs concurrently by their arguments; return their process numbers."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(verbs) + "\n")
        self._process.stdin.flush()
        return [int(text) for text in self._line().split()]

    def ended(self) -> list[int]:
        """Wait for the end of the verbs that were started last; return their exit codes."""
        return [int(text) for text in self._line().split()]

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10.0 * _PATIENCE)  # it may have waited long for the processor


@contextlib.contextmanager
def zygote(folder: Path) -> Iterator[Zygote]:
    """Provide a zygote for the duration of the block."""
    found = Zygote(folder)
    try:
        yield found
    finally:
        found.close()


def verbs(folder: Path, zygote: Zygote) -> dict[str, Verb]:
    """Create the input files and return the verbs that are killed."""
    plan, whole = folder / "plan.yaml", folder / "whole"
    zygote.start(["simulate", "--plan", str(plan), "-o", str(whole), "--effect", "windage"])
    if any(zygote.ended()):
        raise MeasurementError("simulate does not work")
    broken = folder / "broken"
    broken.mkdir()
    data = next(whole.glob("*.mcap")).read_bytes()
    (broken / "broken_0.mcap").write_bytes(data[: int(0.9 * len(data))])
    model = folder / "model" / "wheel.yaml"
    Model("gyrowheel").save(model)
    old = model.read_bytes()

    def check_model() -> str:
        if model.read_bytes() == old:
            return ""
        try:
            found = Model.load(model)
        except InputError as error:
            return str(error)
        return "" if set(found.effects) == {"windage"} else f"effects: {sorted(found.effects)}"

    def recorded(name: str, *arguments: str, fixes: bool = False) -> Verb:
        place = folder / name / "run"

        def prepare() -> None:
            for left in (place, folder / name / "saved"):
                shutil.rmtree(left, ignore_errors=True)
            place.parent.mkdir(exist_ok=True)

        def check() -> str:
            if not place.exists():
                return ""
            try:
                with contextlib.suppress(InputError):
                    Recording.open(place)
                    return ""
                if not fixes:
                    return "half a recording under the name of a whole one"
                if not any(place.glob("*.mcap")):
                    return ""
                wait_for_nodes(place)
                salvage(place, folder / name / "saved")
                if not Recording.open(folder / name / "saved").integrity().complete:
                    return "samples are missing"
            except InputError as error:  # killed before the first sample
                nothing = "holds no message" in str(error) or "no messages on" in str(error)
                return "" if nothing else str(error)
            return ""

        return Verb(
            name.split("_")[0],
            [*arguments, "-o" if not fixes else "--record", str(place)],
            prepare,
            check,
            lambda: (place / "metadata.yaml").exists(),
            place.parent,
        )

    def campaign() -> Verb:
        place = folder / "campaign" / "run"
        begin = ["campaign", "--plan", str(plan), "--validation-plan", str(plan), "--jobs", "1"]
        arguments: list[str] = []
        whole: dict[str, str] = {}

        def cases() -> dict[str, str]:
            found = {}
            for file in place.glob("finished/[!.]*.json"):
                case = json.loads(file.read_text(encoding="utf-8"))["content"]
                case.pop("seconds")  # the duration differs each time
                found[file.name] = json.dumps(case, sort_keys=True)
            return found

        def prepare() -> None:  # it continues until it is finished
            if len(cases()) == CASES:
                whole.update(whole or cases())
                shutil.rmtree(place)
            place.parent.mkdir(exist_ok=True)
            begun = (place / "settings.json").exists()
            new = [*begin, "--cases", str(CASES), "-o", str(place)]
            arguments[:] = ["campaign", "--resume", str(place), "--jobs", "1"] if begun else new

        def check() -> str:
            try:
                other = [name for name, case in cases().items() if whole.get(name, case) != case]
            except (ValueError, KeyError) as error:
                return f"half a case: {error}"
            return f"other results than without a kill: {', '.join(other)}" if other else ""

        return Verb("campaign", arguments, prepare, check, lambda: len(cases()) == CASES, place.parent)

    return {
        "model": Verb(
            "model add",
            ["model", "add", "windage", "--model", str(model), "--fit", str(whole)],
            lambda: void(model.write_bytes(old)),
            check_model,
            lambda: model.read_bytes() != old,
            model.parent,
        ),
        "simulate": recorded("simulate", "simulate", "--plan", str(plan), "--effect", "windage"),
        "salvage": recorded("salvage", "salvage", str(broken)),
        "campaign": campaign(),
        "up": recorded("up", "up", "--plan", str(plan), fixes=True),
    }


def void(_: object) -> None:
    """Ignore the progress."""


def wait_for_nodes(place: Path) -> None:
    """Wait until no process writes a recording any more: nodes end within seconds of their parent."""
    from gyrowheel_recording.bags.writer import being_written

    end = time.monotonic() + _PATIENCE
    while being_written(place) and time.monotonic() < end:
        time.sleep(0.1)


def killed(verb: Verb, zygote: Zygote, count: int, draw: random.Random) -> Kills:
    """Kill a verb at `count` random instants of its work, and check the files each time.

    Instants are drawn up to slightly after its end; those at which it had already ended are drawn again, a few times.
    """
    found = Kills()

    def whole(when: str) -> float:
        verb.prepare()
        begin = time.monotonic()
        zygote.start(verb.arguments)
        if any(code := zygote.ended()):
            found.wrong.append(f"{verb.name} {when}: exit code {code[0]}")
        if not verb.done():
            found.wrong.append(f"{verb.name} {when}: its work is not there")
        return time.monotonic() - begin

    length = whole("before")
    for _ in range(_TRIES * count):
        if found.instants == count:
            break
        verb.prepare()
        delay = draw.uniform(0.0, 1.1 * length)
        (child,) = zygote.start(verb.arguments)
        time.sleep(delay)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        found.instants += zygote.ended() == [-signal.SIGKILL]
        if wrong := verb.check():
            found.wrong.append(f"{verb.name} killed after {delay:.3f} s: {wrong}")
        if verb.done():
            found.after += 1
        else:
            found.before += 1
    whole("after")
    left = [place.name for place in verb.folder.iterdir() if place.name.startswith(".")]
    left = [name for name in left if name != ".machines"]
    if left:
        found.wrong.append(f"{verb.name}: left behind: {', '.join(left)}")
    return found


def written_at_once(model: Path, zygote: Zygote, count: int) -> list[str]:
    """Remove each effect of a model in a separate process, concurrently; return the faults."""
    names = [f"own_{k}" for k in range(count)]
    declared = {"rotor_torque": "-k*z", "coefficients": {"k": {"unit": "N*m/rad", "usual": [0.01, 0.05]}}}
    content = {"schema": 1, "bench": "gyrowheel", "overrides": {}, "effects": {}, "history": []}
    content["effects"] = {name: {"declaration": declared, "k": 0.01} for name in names}
    model.write_text(yaml.safe_dump(content), encoding="utf-8")
    zygote.start(*(["model", "remove", name, "--model", str(model)] for name in names))
    codes = zygote.ended()
    after = Model.load(model)
    wrong = [f"{name}: exit code {code}" for name, code in zip(names, codes, strict=True) if code]
    lost = [name for name, code in zip(names, codes, strict=True) if not code and name in after.effects]
    if len(after.history) != codes.count(0):
        wrong.append(f"{len(after.history)} entries in the history of {codes.count(0)} changes")
    return [*wrong, *(f"{name}: removed without an error, and still there" for name in lost)]


def measure(progress: Fraction, count: int = COUNT, seed: int = 0) -> list[Report]:
    """Kill each verb at an equal number of instants."""
    draw = random.Random(seed)
    figures, wrong, notes = [], [], []
    with tempfile.TemporaryDirectory(prefix="gyrowheel-killed-") as name, zygote(Path(name)) as origin:
        every = verbs(Path(name), origin)
        for number, verb in enumerate(every.values()):
            found = killed(verb, origin, count // len(every), draw)
            figures.append(Figure(f"kills of {verb.name}", found.instants, "instants"))
            notes.append(f"{verb.name}: {found.before} times the old one, {found.after} times the new one.")
            wrong += found.wrong
            progress((number + 1) / len(every))
        wrong += written_at_once(Path(name) / "at_once.yaml", origin, WRITERS)
        figures.append(Figure("writers of one model at once", WRITERS, "processes"))
    figures.append(Figure("something wrong after one", len(wrong), "times", bar=Bar("<=", 0.0)))
    return [Report("Killed while they write", figures, notes=[*notes, *wrong[:5]])]
