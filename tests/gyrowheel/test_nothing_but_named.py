"""Every verb, page and node in a folder full of bait: only files that were named are touched."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from gyrowheel.cli.app import app

from ..domains import next_domain
from .conftest import Wheel
from .helpers import DRAG_PLAN, SHORT_PLAN

#: Modules that Python would import from the current folder.
_MODULES = (
    "numpy", "scipy", "numba", "matplotlib", "sympy", "pydantic", "pyarrow", "typer", "rich", "tornado", "bokeh",
    "yaml", "joblib", "psutil", "nptdms", "h5py", "rclpy", "gyrowheel", "gyrowheel_core", "gyrowheel_sim",
    "random",
    "json", "secrets", "queue", "sitecustomize", "usercustomize",
)  # fmt: skip
#: Settings and libraries that programs look for by these names.
_SETTINGS = (
    "DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml", "cyclonedds.xml", "matplotlibrc",
    ".numba_config.yaml", "bait.pth", "pyvenv.cfg", ".env", "tox.ini", "pytest.ini", "ruff.toml", "setup.cfg",
    "pyproject.toml", ".netrc", "bokeh.yaml", "dask.yaml", "python3", "sh", "libfastrtps.so", "libc.so.6",
    "table.tdms_index", ".gyrowheel.yaml", "gyrowheel.yaml",
)  # fmt: skip
#: What each verb is called with; those of nodes and of OpenFOAM have tests of their own below, or none.
_CALLS = (
    "model new --model new.yaml",
    "simulate --plan short.yaml -o made --effect windage",
    "info wheel/drag",
    "export wheel/drag -o table.csv",
    "import --suggest table.csv -o table.map.yaml",
    "import table.csv --map table.map.yaml -o imported",
    "import --suggest table.tdms",
    "salvage wheel/drag -o saved",
    "correct wheel/drag -o right --exchange tilt_x:tilt_y",
    "compare wheel/drag --model wheel/model.yaml --map speed --picture map.png",
    "diagnose wheel/drag --model wheel/model.yaml --json found.json --picture found.png",
    "model add windage --model new.yaml --fit wheel/drag",
    "model fit wheel/drag --model new.yaml --free windage.w",
    "model show --model new.yaml",
    "model diff wheel/model.yaml new.yaml",
    "model export --model new.yaml -o plant.py",
    "report wheel/drag --model wheel/model.yaml -o report.html",
    "model remove windage --model new.yaml",
    "model undo --model new.yaml",
    "rate wheel/drag --model wheel/model.yaml",
    "torques wheel/drag --model wheel/model.yaml",
    "momentum --picture caps.png",
    "drag wheel/drag --model wheel/model.yaml --picture drag.png",
    "calibrate wheel/drag --model wheel/model.yaml",
    "effects windage",
    "plans short.yaml",
    "bench",
    "air --tilt 5 --speed 3500",
    "key key.json --against wheel/model.yaml",
    "batch wheel --model wheel/model.yaml --jobs 1 -o rows.csv",
    "trend rows.csv --picture trend.png",
    "campaign --cases 1 --plan drag.yaml --jobs 1 -o campaign",
    "run",
)
#: Verbs that compile, read and write each kind of file, and draw.
_FEW = ("model new", "simulate", "export", "import", "compare", "momentum")
#: Verbs of which the same code runs elsewhere in the list, or that need OpenFOAM.
_ELSEWHERE = {
    "demo", "up", "replay", "live", "workbench", "paper", "investigate", "cfd mesh", "cfd run", "cfd sweep",
    "cfd table", "cfd pictures",
}  # fmt: skip
_DRIVER = """\
import sys
from gyrowheel.cli.app import app
from gyrowheel.cli.console import run
from gyrowheel_core.surroundings import begin
begin()
codes = [run(app, call.split()) for call in sys.argv[1:]]
from pathlib import Path
from urllib.request import urlopen
import gyrowheel as gw
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session
session = Session(Library([Path("wheel")]), gw.Model())
with Server(session, port=0) as server:
    session.open("0/drag", "fitted")
    session.wait(300.0)
    session.diagnose()
    session.wait(300.0)
    session.write_report()
    session.wait(300.0)
    assert session.trouble is None, session.trouble
    for page in ("", "state", "found", "heard", "report", "help", "files/page.css"):
        urlopen(server.url + page).read()
print("codes", codes)
"""


def _commands(group: object, before: str = "") -> Iterator[str]:
    for name, own in getattr(group, "commands", {}).items():
        if getattr(own, "commands", None):
            yield from _commands(own, f"{before}{name} ")
        else:
            yield f"{before}{name}"


def test_every_verb_is_tried() -> None:
    tried = {
        verb
        for verb in _commands(typer.main.get_command(app))
        if any(f"{c} ".startswith(f"{verb} ") for c in _CALLS)
    }
    assert tried | _ELSEWHERE == set(_commands(typer.main.get_command(app)))


@pytest.fixture
def bait(tmp_path: Path) -> Path:
    """Make a folder of files whose use leaves a file `used` behind, or a log."""
    folder = tmp_path / "bait"
    folder.mkdir()
    for name in _MODULES:
        (folder / f"{name}.py").write_text(f"open({str(tmp_path / 'used')!r}, 'w')\n")
    for name in _SETTINGS:
        (folder / name).write_text("lines.linewidth: 30\n")
    profiles = (
        '<?xml version="1.0"?><dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><log><use_default>FALSE'
        "</use_default><consumer><class>FileConsumer</class><property><name>filename</name>"
        f"<value>{tmp_path / 'used'}</value></property></consumer></log></dds>"
    )
    (folder / "DEFAULT_FASTRTPS_PROFILES.xml").write_text(profiles)
    (folder / ".numba_config.yaml").write_text("disable_jit: 1\n")
    (folder / "short.yaml").write_text(SHORT_PLAN)
    (folder / "drag.yaml").write_text(DRAG_PLAN)
    return folder


def _traced(command: list[str], folder: Path, **variables: str) -> tuple[str, list[str]]:
    """Return the output of a command, and its system calls with files and addresses where they can be traced."""
    log = folder.parent / "trace"
    tracer = shutil.which("strace") or ""
    ahead = [
        tracer,
        "-f",
        "-qq",
        "--seccomp-bpf",
        "-e",
        "trace=%file,bind",
        "-e",
        "signal=none",
        "-o",
        str(log),
    ]
    if not tracer or subprocess.run([*ahead, "true"], check=False, capture_output=True).returncode:
        ahead = []
    environment = os.environ | variables | {"COLUMNS": "200"}
    environment.pop("PYTHONSAFEPATH", None)
    done = subprocess.run(
        [*ahead, *command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout, log.read_text(errors="replace").splitlines() if ahead else []


def _touched(calls: list[str], folder: Path) -> set[str]:
    """Return the bait that any system call names."""
    names = {*_SETTINGS, *(f"{name}.py" for name in _MODULES)}
    paths = (match[1] for call in calls if (match := re.search(r'"((?:[^"\\]|\\.)*)"', call)))
    return {path for path in paths if Path(path).name in names and Path(path).parent in (Path(), folder)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "calls",
    [tuple(call for call in _CALLS if call.startswith(_FEW)), pytest.param(_CALLS, marks=pytest.mark.study)],
    ids=("few", "all"),
)
def test_verbs_and_pages_touch_no_file_that_was_not_named(
    calls: tuple[str, ...], bait: Path, wheel: Wheel
) -> None:
    """In one process under strace, where it is installed; else by what the bait leaves behind."""
    nptdms = pytest.importorskip("nptdms")
    shutil.copytree(wheel.recording.parent, bait / "wheel")
    with nptdms.TdmsWriter(str(bait / "table.tdms")) as writer:
        writer.write_segment(
            [nptdms.ChannelObject("g", name, [float(k) for k in range(50)]) for name in "ab"]
        )
    assert not (bait / "key.json").exists()
    out, traced = _traced([sys.executable, "-P", "-c", _DRIVER, *calls], bait)
    codes = json.loads(out.rpartition("codes ")[2])
    assert not (bait.parent / "used").exists()
    assert {call: code for call, code in zip(calls, codes, strict=True) if code > 2} == {}
    assert _touched(traced, bait) == set()


@pytest.mark.slow
@pytest.mark.graph
def test_nodes_touch_no_file_that_was_not_named(bait: Path) -> None:
    """They listen on this computer alone, too."""
    program = Path(sys.prefix, "bin/gyrowheel")
    command = [str(program), "up", "--plan", "short.yaml", "--record", "made"]
    _, calls = _traced(command, bait, ROS_DOMAIN_ID=str(next_domain()))
    assert not (bait.parent / "used").exists()
    assert (bait / "made" / "metadata.yaml").exists()
    assert _touched(calls, bait) == set()
    bound = {match[1] for call in calls if (match := re.search(r"bind\(.*?inet_addr\(\"(.*?)\"\)", call))}
    assert bound <= {"127.0.0.1"}
