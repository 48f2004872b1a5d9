"""The workbench under load and under faults of its computer: pages are answered meanwhile."""

from __future__ import annotations

import errno
import itertools
import os
import random
import resource
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import gyrowheel as gw
from gyrowheel.workbench import server as workbench_server
from gyrowheel.workbench.library import Library
from gyrowheel.workbench.server import Server
from gyrowheel.workbench.session import Session, Step

from .conftest import Wheel
from .helpers import ask
from .killing import killed

_HOLDS = """\
import sys
from pathlib import Path
from gyrowheel_core.locks import changing
with changing(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def server(wheel: Wheel, tmp_path: Path) -> Iterator[Server]:
    """Serve recordings and a model of which each test has its own copy."""
    shutil.copytree(wheel.recording, tmp_path / "runs" / "drag")
    model = tmp_path / "model.yaml"
    shutil.copy(wheel.model, model)
    with Server(Session(Library([tmp_path / "runs"]), gw.Model.load(model), model), port=0) as own:
        yield own


def _job(server: Server) -> str:
    job = server.session.job
    return "" if job is None else job.line


def test_saving_waits_for_another_process_and_the_page_is_answered_meanwhile(
    server: Server, tmp_path: Path
) -> None:
    model = tmp_path / "model.yaml"
    command = [sys.executable, "-c", _HOLDS, str(model)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        before = model.read_bytes()
        assert ask(server, "/do/save", {"name": "model.yaml"})[0] == 200
        while "waiting: process" not in _job(server):
            time.sleep(0.01)
        assert f"process {holder.pid} (" in _job(server)  # which holds the model
        assert "end this to save under another name" in _job(server)
        for page in ("/", "/state", "/found", "/help"):
            assert ask(server, page)[0] == 200
        status, said = ask(server, "/do/save", {"name": "other.yaml"})
        assert (status, b"busy: saving model.yaml" in said) == (422, True)
        assert ask(server, "/do/end", {})[0] == 200
        assert ask(server, "/do/save", {"name": "other.yaml"})[0] == 200
        server.session.wait(240.0)
        assert server.session.saved.endswith("other.yaml")
        holder.communicate()
    assert model.read_bytes() == before  # what was ended writes nothing later


def test_a_workbench_killed_while_it_saves_leaves_the_old_or_the_new_model(
    wheel: Wheel, tmp_path: Path
) -> None:
    model, rng = tmp_path / "model.yaml", random.Random(4)
    shutil.copy(wheel.model, model)
    both = [gw.Model.load(model), gw.Model("dtg")]
    contents = [own.to_dict() for own in both]
    assert contents[0] != contents[1]

    def save() -> None:
        session = Session(Library([wheel.recording.parent]), both[0], model)
        session.steps.append(Step(both[1]))
        with Server(session, port=0) as own:
            (tmp_path / "begun").touch()
            for action in itertools.cycle(("undo", "redo")):
                assert ask(own, f"/do/{action}", {})[0] == 200
                assert ask(own, "/do/save", {"name": "model.yaml"})[0] == 200
                session.wait(240.0)

    for _ in range(10):
        (tmp_path / "begun").unlink(missing_ok=True)
        assert not killed(save, rng.uniform(0.0, 0.2), (tmp_path / "begun").exists)
        assert gw.Model.load(model).to_dict() in contents
    both[1].save(model)
    (tmp_path / "begun").unlink()
    assert [place.name for place in tmp_path.iterdir()] == ["model.yaml"]


@pytest.mark.parametrize("few", [False, True])
def test_hundreds_of_connections_leave_the_page_answered(
    few: bool, server: Server, capfd: pytest.CaptureFixture[str]
) -> None:
    """Also with few file descriptors: the oldest connections are closed."""
    usual = resource.getrlimit(resource.RLIMIT_NOFILE)
    others: list[socket.socket] = []
    if few:
        resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + 100, usual[1]))
    try:
        for _ in range(300):
            try:
                others.append(socket.create_connection(("127.0.0.1", server.port), timeout=2.0))
            except OSError:  # no descriptor is free in this process, which is client and server
                others.pop(0).close()
        for own in others[:50]:
            own.close()
        for page in ("/", "/state", "/help"):
            assert ask(server, page)[0] == 200
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, usual)
        for own in others:
            own.close()
    assert "Traceback" not in capfd.readouterr().err


def test_two_hundred_jobs_and_twenty_saves_leave_one_model(server: Server, tmp_path: Path) -> None:
    """One works at a time; the others are refused by its name."""
    answers = []
    for number in range(200):
        role = ("fitted", "not used to fit")[number % 2]
        answers.append(ask(server, "/do/open", {"key": "0/drag", "role": role}))
        if number % 10 == 0:
            server.session.wait(240.0)
            answers.append(ask(server, "/do/save", {"name": "model.yaml"}))
    assert ask(server, "/state")[0] == 200
    assert {status for status, _ in answers} <= {200, 422}
    assert all(b"busy: " in said for status, said in answers if status == 422)
    server.session.wait(240.0)
    assert gw.Model.load(tmp_path / "model.yaml").to_dict() == server.session.step.model.to_dict()
    assert not list(tmp_path.glob(".*"))


def test_an_upload_to_a_full_disk_or_a_removed_folder_is_an_error_and_no_reset(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: object, chunk: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as own:
        own.setattr(workbench_server, "_write", full)
        status, said = ask(
            server, "/table?name=a.csv", "1" * 3_000_000, Content_Type="application/octet-stream"
        )
        assert (status, b"cannot be written: No space left on device" in said) == (422, True)
    scratch = server.session._scratch
    assert scratch is not None
    assert not [file for file in Path(scratch.name).rglob("*") if file.is_file()]
    shutil.rmtree(scratch.name)
    assert ask(server, "/table?name=a.csv", "1,2", Content_Type="application/octet-stream")[0] == 200
    server.session.wait(240.0)
    assert server.session.trouble is not None  # no table


@pytest.mark.parametrize("kind", ["exchanged", "cut off", "removed"])
def test_a_recording_changed_after_it_was_read_is_marked_and_no_report_certifies_it(
    kind: str, server: Server, tmp_path: Path, wheel: Wheel
) -> None:
    session, folder = server.session, tmp_path / "runs" / "drag"
    session.open("0/drag", "fitted")
    session.wait(240.0)
    (own,) = session.opened.values()
    assert "drag_0.mcap" in {file.name for file in own.recording.data.certified()}
    file = folder / "drag_0.mcap"
    file.chmod(0o600)  # changes no content
    assert own.recording.data.is_changed
    own.recording.data.certified()
    if kind == "exchanged":
        shutil.rmtree(folder)
        shutil.copytree(wheel.other, folder)
    elif kind == "cut off":
        os.truncate(file, file.stat().st_size // 2)
    else:
        shutil.rmtree(folder)
    assert b"changed after they were read" in ask(server, "/state")[1]
    with pytest.raises(gw.InputError, match="was changed after it was read"):
        own.recording.data.certified()
    session.close("0/drag")
    assert b"changed after they were read" not in ask(server, "/state")[1]
