"""Every verb, page and node in a folder full of bait: only files that were named are touched."""

from __future__ import annotations

import ipaddress
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

import gyrowheel
from gyrowheel.batches.api import COLUMNS, write_rows
from gyrowheel.cli.app import app
from gyrowheel_core import cache

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
    "model fit --fit wheel/drag --model new.yaml --free windage.w",
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
    "simulate --plan short.yaml -o hidden --blind key.json",
    "key key.json --against wheel/model.yaml",
    "batch wheel --model wheel/model.yaml --jobs 1 -o rows.csv",
    "trend many.csv --picture trend.png",
    "campaign --cases 1 --plan drag.yaml --jobs 1 -o campaign",
    "run",
)
#: Verbs that compile, read and write each kind of file, and draw.
_FEW = ("model new", "simulate", "export", "import", "compare", "momentum")
#: What the verbs are called with that start nodes or servers, work for minutes, or need OpenFOAM.
_PROGRAMS = (
    "up --plan short.yaml --record made",
    "replay wheel/drag --to 1",
    "live --port 0",
    "workbench wheel --port 0",
    "investigate --model wheel/model.yaml --effect windage --budget 1 -o investigation",
    "demo -o demo",
    "paper --only table-1 -o paper",
    "cfd mesh --mesh tiny -o study",
    "cfd run --mesh tiny --iterations 20 -o study",
    "cfd sweep --mesh tiny --iterations 20 --tilts 0,5 --speeds 3000,3500 -o sweep",
    "cfd table -o air.json",
    "cfd pictures -o pictures",
)
#: Where everything that a verb opens is, besides its arguments and results: the programs, their settings on this
#: computer, and folders for temporary files.
_ALLOWED = (
    "/dev", "/etc", "/lib", "/lib64", "/opt", "/proc", "/sys", "/usr", "/var/cache/fontconfig",
    sys.prefix, sys.base_prefix,
)  # fmt: skip
_DRIVER = """\
import sys
from gyrowheel.cli.app import app
from gyrowheel.cli.console import run
from gyrowheel_core.surroundings import begin
begin()
codes = [run(app, call.split()) for call in sys.argv[1:]]
from pathlib import Path
from urllib.request import Request, urlopen
import gyrowheel as gw
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session
session = Session(Library([Path("wheel")]), gw.Model())
with Server(session, port=0) as server:
    session.open("0/drag", "fitted")
    session.wait(300.0)
    if any(call.startswith("report") for call in sys.argv[1:]):
        session.diagnose()
        session.wait(300.0)
        session.write_report()
        session.wait(300.0)
    assert session.trouble is None, session.trouble
    sent = {"Content-Type": "application/octet-stream"}
    table = Path("table.csv").read_bytes() if Path("table.csv").exists() else b"t,x"
    urlopen(Request(server.url + "table?name=table.csv", table, sent)).read()
    session.wait(300.0)
    span = "key=0/drag&from=0&until=1"
    pages = "", "state", "found", "heard", "help", "help/effect/windage", "files/page.css"
    if session.report:
        pages = *pages, "report"
    if session.table and session.table.picture:
        pages = *pages, "preview.png"
    for page in (*pages, "sample?key=0/drag&time=1", f"motion?{span}", f"signal?{span}&points=9"):
        urlopen(server.url + page).read()
print("codes", codes)
"""


def commands(group: object, before: str = "") -> Iterator[str]:
    for name, own in getattr(group, "commands", {}).items():
        if getattr(own, "commands", None):
            yield from commands(own, f"{before}{name} ")
        else:
            yield f"{before}{name}"


def test_every_verb_is_tried() -> None:
    verbs = set(commands(typer.main.get_command(app)))
    assert verbs == {v for v in verbs if any(f"{c} ".startswith(f"{v} ") for c in (*_CALLS, *_PROGRAMS))}


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
        "-z",
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
    environment = os.environ | variables | {"COLUMNS": "200", "HOME": str(folder.parent / "home")}
    for name in ("scratch", "home"):
        (folder.parent / name).mkdir()
    environment["TMPDIR"] = str(folder.parent / "scratch")
    environment["GYROWHEEL_CACHE"] = str(cache.folder() or folder.parent / "home")
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
    assert done.returncode in (0, 130), done.stderr[-3000:]
    return done.stdout, log.read_text(errors="replace").splitlines() if ahead else []


def _opened(calls: list[str], folder: Path) -> set[Path]:
    """Return the files that were opened, and the bait that any system call names."""
    names = {*_SETTINGS, *(f"{name}.py" for name in _MODULES)}
    found = set()
    for call in calls:
        if (match := re.search(r'(\w+)\((?:AT_FDCWD, )?"((?:[^"\\]|\\.)*)"', call)) is None:
            continue
        place = Path(os.path.normpath(folder / match[2]))
        bait = place.name in names and place.parent == folder
        if bait or (match[1].startswith("open") and "O_DIRECTORY" not in call):
            found.add(place)
    return found


def _unnamed(calls: list[str], words: set[str], folder: Path) -> set[str]:
    """Return what was opened without being named: neither below a word of the command nor where programs are."""
    named = [folder / word for word in words] + [folder / ".machines"]
    results = tuple(f".{word}." for word in words)  # while they are written, and their locks
    root = Path(gyrowheel.__file__).parents[3]
    own = [folder.parent / "scratch", folder.parent / "home", root / "src", cache.folder() or root / "src"]
    allowed = [*map(Path, _ALLOWED), *own]
    return {
        str(place)
        for place in _opened(calls, folder)
        if not any(place.is_relative_to(own) for own in (*named, *allowed))
        and not os.path.relpath(place, folder).startswith(results)
    }


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
    row = dict.fromkeys(COLUMNS) | {"verdict": "effect", "machine": "a", "error": ""}
    values = {"windage.w": 1e-3, "windage.w.error": 1e-5}
    write_rows(
        bait / "many.csv",
        [row | values | {"recording": f"r{k}", "key": f"{k}", "start": 1e5 * k} for k in range(12)],
    )
    out, traced = _traced([sys.executable, "-P", "-c", _DRIVER, *calls], bait)
    codes = json.loads(out.rpartition("codes ")[2])
    assert not (bait.parent / "used").exists()
    assert {call: code for call, code in zip(calls, codes, strict=True) if code > 1} == {}
    assert _unnamed(traced, {"wheel", *" ".join(calls).split()}, bait) == set()
    assert all(ipaddress.ip_address(own).is_loopback for own in _bound(traced))


@pytest.mark.slow
@pytest.mark.graph
@pytest.mark.parametrize(
    "call", [_PROGRAMS[0], *(pytest.param(call, marks=pytest.mark.study) for call in _PROGRAMS[1:])]
)
def test_nodes_and_servers_touch_no_file_that_was_not_named(call: str, bait: Path, wheel: Wheel) -> None:
    """They listen on this computer alone, too."""
    if call.startswith("cfd") and not shutil.which("simpleFoam"):
        pytest.skip("needs OpenFOAM")
    shutil.copytree(wheel.recording.parent, bait / "wheel")
    ahead = ["timeout", "--preserve-status", "--signal=INT", "20"] * call.startswith(("live", "workbench"))
    program = str(Path(sys.prefix, "bin/gyrowheel"))
    _, calls = _traced([*ahead, program, *call.split()], bait, ROS_DOMAIN_ID=str(next_domain()))
    assert not (bait.parent / "used").exists()
    assert _unnamed(calls, set(call.split()), bait) == set()
    assert all(ipaddress.ip_address(own).is_loopback for own in _bound(calls))


def _bound(calls: list[str]) -> set[str]:
    """Return the addresses at which sockets were opened for others."""
    address = re.compile(r'bind\(.*?inet_(?:addr|pton)\((?:AF_INET6, )?"(.*?)"')
    return {match[1] for call in calls if (match := address.search(call))}
