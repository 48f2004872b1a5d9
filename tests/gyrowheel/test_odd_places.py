"""Folders and files of odd names, and disks that are full: every verb works, or says in one line that it does not."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.cli.console import BAD_INPUT, OK

from .conftest import Wheel
from .helpers import Shell, write

#: A space, quotes, a line break, escapes of terminals, letters of other scripts, marks that mean something in paths of
#: ours and in formulas of pictures, a byte that is no text, and a dash that no option begins with.
ODD = os.fsdecode(b"a 'b\" \n\t\x1b[2J\x9b \xc3\xa9\xe2\x84\xa6 @from= %d {x} $x^$ \xff -")


@pytest.mark.slow
def test_every_verb_reads_and_writes_files_with_odd_names(
    gyrowheel: Shell, wheel: Wheel, tmp_path: Path
) -> None:
    """What is written under an odd name is read from it, by each verb that writes."""
    for stream in (sys.stdout, sys.stderr):  # as the program does where it is started
        assert isinstance(stream, io.TextIOWrapper)
        stream.reconfigure(errors="replace")
    folder = tmp_path / ODD
    folder.mkdir()
    recording = folder / ODD
    shutil.copytree(wheel.recording, recording)
    model, columns = folder / f"{ODD}.yaml", folder / "map.yaml"
    for made, *arguments in (
        (model, "model", "new", "--model", model),
        (folder / f"info {ODD}", "info", recording, "--json", folder / f"info {ODD}"),
        (folder / f"saved {ODD}", "salvage", recording, "-o", folder / f"saved {ODD}"),
        (folder / f"{ODD}.csv", "export", recording, "-o", folder / f"{ODD}.csv", "--map", columns),
        (folder / f"{ODD}.parquet", "export", recording, "-o", folder / f"{ODD}.parquet"),
        (folder / f"in {ODD}", "import", folder / f"{ODD}.csv", "--map", columns, "-o", folder / f"in {ODD}"),
        (
            folder / f"right {ODD}",
            "correct",
            recording,
            "-o",
            folder / f"right {ODD}",
            "--scale",
            "tilt_x=-1",
        ),
        (
            folder / f"{ODD}.png",
            "compare",
            recording,
            "--model",
            model,
            "--picture",
            folder / f"{ODD}.png",
            "--json",
            folder / f"{ODD}.json",
        ),
    ):
        done = gyrowheel(*map(str, arguments))
        assert done.code == OK, (arguments[0], done.err)
        assert made.exists()
        assert "\x1b" not in done.out + done.err
    assert json.loads((folder / f"{ODD}.json").read_text(encoding="utf-8"))["recordings"]
    before, after = gw.Recording.open(recording), gw.Recording.open(folder / f"in {ODD}")
    assert len(before.data.measurement) == len(after.data.measurement)


@pytest.mark.study  # one verb more
def test_a_report_is_written_under_an_odd_name(gyrowheel: Shell, wheel: Wheel, tmp_path: Path) -> None:
    report = tmp_path / f"{ODD}.html"
    done = gyrowheel("report", str(wheel.recording), "--model", str(wheel.model), "-o", str(report))
    assert done.code == OK, done.err
    assert report.exists()


@pytest.fixture
def full(tmp_path: Path) -> Iterator[Path]:
    """Give a file system with room for 64 kB."""
    folder = tmp_path / "full"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("file systems cannot be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


#: Every kind of file: a model that is replaced, results, pictures, recordings, and tables.
WRITING = (
    "model remove windage --model {full}/wheel.yaml",
    "info {recording} --json {full}/a.json",
    "momentum --picture {full}/a.png",
    "salvage {recording} -o {full}/saved",
    "correct {recording} -o {full}/right --scale tilt_x=-1",
    "export {recording} -o {full}/a.csv",
    "export {recording} -o {full}/a.parquet",
)
#: Those that fit before they write a file of the same kinds, and the report.
FITTING = (
    "model add windage --model {full}/wheel.yaml --fit {recording}",
    "compare {recording} --model {model} --json {full}/a.json",
    "report {recording} --model {model} -o {full}/a.html",
)


@pytest.mark.parametrize(
    "calls", [WRITING, pytest.param(FITTING, marks=pytest.mark.study)], ids=["writing", "fitting"]
)
def test_a_full_disk_under_every_verb_that_writes(
    calls: tuple[str, ...], gyrowheel: Shell, wheel: Wheel, full: Path
) -> None:
    """One line, exit code 2; what was there is as it was, and nothing is beside it."""
    model = full / "wheel.yaml"
    effects = "" if calls is FITTING else "windage: {w: 0.001, n: 1.5}"
    write(model, f"schema: 1\nbench: gyrowheel\noverrides: {{}}\neffects: {{{effects}}}\nhistory: []\n")
    old = model.read_bytes()
    (full / "filling").write_bytes(bytes(64 * 1024 - 4096))  # the model has the last page
    for call in calls:
        arguments = [
            word.format(full=full, recording=wheel.recording, model=wheel.model) for word in call.split()
        ]
        done = gyrowheel(*arguments)
        assert done.code == BAD_INPUT, (arguments, done.err)
        last = done.err.strip().splitlines()[-1]
        assert last.startswith("error: "), last
        assert last.endswith("No space left on device"), last
        assert model.read_bytes() == old
        assert sorted(place.name for place in full.iterdir()) == ["filling", "wheel.yaml"], arguments
