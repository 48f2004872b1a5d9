"""Golden results: what every verb of the analysis says of fourteen recordings, for use before and after a change.

``tools/golden.py write DIR`` simulates the recordings and takes them through compare, diagnose, model add, calibrate,
rate and investigate by the command line, so that it works on any version of the code; a result that is there is kept.
``tools/golden.py check OLD NEW`` compares two such folders number by number, to the last digit unless ``--within``
allows more. Seconds, times of day and versions are left out.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GYROWHEEL = Path(sys.executable).with_name("gyrowheel")
#: Fields that differ from run to run.
_VOLATILE = {"seconds", "versions", "time", "median_seconds"}
_FLOAT_FIELDS = ("value", "standard_error")


@dataclass(frozen=True)
class Case:
    """A recording: its plan, bench, machine and what is hidden in it."""

    name: str
    plan: str
    effects: tuple[str, ...] = ()
    machine: int | None = None
    bench: str = "gyrowheel"
    hidden: str = ""  # an effect that no declaration has, written into a key file
    check: str = "check"
    investigate: bool = False


CASES = (
    Case("quick_none", "quick", machine=3),
    Case("quick_one", "quick", ("aero_cross",), 6, investigate=True),
    Case("quick_two", "quick", ("windage:w=0.0013", "tilt_rotation"), 8),
    Case("quick_unknown", "quick", hidden='{"contact": {"A": 0.012, "p": 0.45}}', investigate=True),
    Case("survey_none", "survey", machine=5),
    Case("survey_two", "survey", ("flexure_hysteresis", "coil_heating"), 2),
    Case("survey_unknown", "survey", hidden='{"three_lobed": {"A": 0.003}}'),
    Case("paper_tilt_air", "paper_tilt", ("aero:table",), 4),
    Case("paper_speed_one", "paper_speed", ("windage",), 7),
    Case("cone_one", "cone", ("external_damping",), 1),
    Case("coast_down_two", "coast_down", ("windage", "bearing_viscous"), 9),
    Case("dtg_none", "dtg_quick", machine=2, bench="dtg", check="dtg_check"),
    Case("dtg_one", "dtg_quick", ("flexure_damping",), 3, bench="dtg", check="dtg_check", investigate=True),
    Case("dtg_two", "dtg_cone", ("tilt_rotation", "static_imbalance"), 5, bench="dtg", check="dtg_check"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write golden results, or compare two sets of them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    write = verbs.add_parser("write")
    write.add_argument("folder", type=Path)
    write.add_argument("--jobs", type=int, default=2)
    write.add_argument("--only", action="append", help="names of cases")
    write.add_argument("--recordings", type=Path, help="folder of an earlier set whose recordings are used")
    check = verbs.add_parser("check")
    check.add_argument("old", type=Path)
    check.add_argument("new", type=Path)
    check.add_argument(
        "--within", type=float, default=0.0, help="difference allowed [standard errors, or relative]"
    )
    given = parser.parse_args(arguments)
    if given.verb == "check":
        return compare(given.old, given.new, given.within)
    cases = [case for case in CASES if given.only is None or case.name in given.only]
    with ThreadPoolExecutor(given.jobs) as pool:
        list(pool.map(lambda case: run(case, given.folder.resolve(), given.recordings), cases))
    return 0


def run(case: Case, folder: Path, recordings: Path | None = None) -> None:
    """Make one recording and take it through all verbs; results are `folder`/case/VERB.json."""
    place = folder / case.name
    place.mkdir(parents=True, exist_ok=True)
    if recordings is not None:
        for name in ("fit", "check"):
            if not (place / name).exists():
                (place / name).symlink_to((recordings / case.name / name).resolve())
    machine = [] if case.machine is None else ["--machine", str(case.machine)]
    for effect in case.effects:
        machine += ["--effect", effect]
    if case.hidden:
        key = place / "key.json"
        key.write_text(json.dumps({"values": {}, "effects": json.loads(case.hidden)}), encoding="utf-8")
        machine = ["--blind", "key.json"]
    for plan, name in ((case.plan, "fit"), (case.check, "check")):
        if not (place / name).exists():
            _call(
                place, "simulate", "--plan", plan, "-o", name, "--bench", case.bench, "--seed", "1", *machine
            )
    model = place / "model.yaml"
    if not model.exists():
        _call(place, "model", "new", "--model", "model.yaml", "--bench", case.bench)
    _result(place, "compare", "compare", "fit", "--model", "model.yaml")
    found = _result(place, "diagnose", "diagnose", "fit", "--model", "model.yaml", "--validate", "check")
    names = [effect["name"] for effect in found.get("effects", ())] or ["windage"]
    formulas = [f"--formula={form['name']}: {form['formula']}" for form in found.get("free_form", ())]
    changed = place / "added.yaml"
    if not (place / "add.json").exists():
        changed.write_bytes(model.read_bytes())
    _result(
        place, "add", "model", "add", *names, *formulas, "--model", "added.yaml", "--fit", "fit", "--validate", "check"
    )  # fmt: skip
    _result(place, "model", "model", "show", "--model", "added.yaml")
    _result(place, "compare_after", "compare", "check", "--model", "added.yaml")
    _result(place, "calibrate", "calibrate", "fit", "--model", "model.yaml")
    _result(place, "rate", "rate", "fit", "--model", "model.yaml")
    _result(place, "info", "info", "fit")
    if case.investigate and not (place / "investigate.json").exists():
        _result(
            place, "investigate", "investigate", "fit", "--model", "model.yaml", "--simulate", "--budget", "3",
            "--seed", "1", "-o", "investigation", *machine,
        )  # fmt: skip


def _call(place: Path, *arguments: str) -> tuple[int, str]:
    done = subprocess.run(
        [GYROWHEEL, *arguments],
        cwd=place,
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    print(f"{place.name:16} {done.returncode} {' '.join(arguments)[:90]}", flush=True)
    if done.returncode not in (0, 1):
        print(f"    {done.stderr.strip()[-300:]}", flush=True)
    return done.returncode, done.stderr


def _result(place: Path, name: str, *arguments: str) -> dict[str, Any]:
    """Return the JSON of a verb; what it says on bad input is its exit code."""
    file = place / f"{name}.json"
    if not file.exists():
        code, _ = _call(place, *arguments, "--json", file.name)
        if code not in (0, 1):
            file.write_text(json.dumps({"exit_code": code}), encoding="utf-8")
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return content


def leaves(content: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every number and text of a result with its path."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key not in _VOLATILE:
                yield from leaves(value, f"{path}.{key}")
    elif isinstance(content, list):
        for number, value in enumerate(content):
            yield from leaves(value, f"{path}[{number}]")
    else:
        yield path, content


def compare(old: Path, new: Path, within: float = 0.0) -> int:
    """Print every difference between two sets of results; return 1 if a number differs or a result is missing."""
    numbers = differing = texts = 0
    for file in sorted(old.glob("*/*.json")):
        if file.name == "key.json":
            continue
        other = new / file.relative_to(old)
        if not other.exists():
            print(f"{file.relative_to(old)}: missing")
            differing += 1
            continue
        contents = [json.loads(f.read_text(encoding="utf-8")) for f in (file, other)]
        before, after = (dict(leaves(content)) for content in contents)
        for path in sorted(before.keys() | after.keys()):
            if path not in after:
                print(f"{file.relative_to(old)}{path}: {before[path]!r:.70} -> not there")
                differing += 1
                continue
            if path not in before:
                print(f"{file.relative_to(old)}{path}: new: {after[path]!r:.70}")
                continue
            a, b = before[path], after[path]
            if isinstance(a, bool | str) or a is None or not isinstance(b, int | float):
                if a != b:
                    print(f"{file.relative_to(old)}{path}: {a!r:.70} -> {b!r:.70}")
                    texts += 1
                continue
            numbers += 1
            if a != b and not math.isclose(a, b, rel_tol=within, abs_tol=within * _scale(before, path)):
                print(f"{file.relative_to(old)}{path}: {a!r} -> {b!r}")
                differing += 1
    print(f"{numbers} numbers, {differing} different or missing; {texts} texts different")
    return int(differing > 0)


def _scale(values: dict[str, Any], path: str) -> float:
    """Return the standard error beside a value, 0 where there is none."""
    stem, _, name = path.rpartition(".")
    error = values.get(f"{stem}.standard_error", 0.0) if name in _FLOAT_FIELDS else 0.0
    return float(error or 0.0)


if __name__ == "__main__":
    sys.exit(main())
