"""What nobody foresaw ends with one line, exit code 70 and a report without the user's data."""

import errno
import os
import re
import signal
import subprocess
import sys
import textwrap
from importlib.metadata import version
from pathlib import Path

import pytest
import typer

from gyrowheel.cli.console import BAD_INPUT, INTERNAL_ERROR, _console, run

_SECRET = "prototype-of-a-customer"


def _app(error: BaseException) -> typer.Typer:
    app = typer.Typer()

    @app.command()
    def verb(name: str) -> None:
        try:
            dict[str, str]()[name]
        except KeyError:
            raise error from None

    return app


def test_internal_error_is_one_line_and_a_report_without_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line with the exception and the file of the report; the report names places, not data."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert run(_app(ZeroDivisionError(f"{_SECRET} over\nzero")), [_SECRET]) == INTERNAL_ERROR == 70
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(
        f"error: internal error in gyrowheel: ZeroDivisionError: {_SECRET} over zero; details in "
    )
    report = Path(said.rpartition("details in ")[2].strip())
    assert report.parent == tmp_path / "state" / "gyrowheel"
    text = report.read_text()
    assert _SECRET not in text
    assert "builtins.ZeroDivisionError" in text
    assert re.search(r"gyrowheel\.cli\.console:\d+ in run", text)
    assert re.search(r"numpy \d", text)
    assert report.stat().st_mode & 0o077 == 0


def test_reports_do_not_pile_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for _ in range(30):
        assert run(_app(RuntimeError("odd")), ["x"]) == INTERNAL_ERROR
    assert len(list((tmp_path / "gyrowheel").iterdir())) == 10


def test_a_package_of_pythonpath_is_named_where_it_does_not_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The defect is none of the program; with the same version, it is one."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "numpy.py").touch()
    assert run(_app(AttributeError("no attribute linspace")), ["x"]) == BAD_INPUT
    said = (
        f"error: PYTHONPATH: {tmp_path}/numpy.py (no version) takes the place of numpy {version('numpy')}: "
    )
    assert capsys.readouterr().err.startswith(said)
    (tmp_path / "numpy.py").unlink()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert run(_app(AttributeError("no attribute linspace")), ["x"]) == INTERNAL_ERROR


def test_internal_error_without_a_writable_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line comes all the same."""
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/none")
    monkeypatch.setattr("tempfile.tempdir", "/proc/none")
    assert run(_app(RuntimeError("odd")), ["x"]) == INTERNAL_ERROR
    assert "RuntimeError: odd; no file could be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "not enough memory"),
        (OSError(errno.EMFILE, "Too many open files", "signals.mcap"), "Too many open files: signals.mcap"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
    ],
)
def test_missing_memory_descriptors_and_disk_space(
    error: BaseException, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Too little memory, disk or descriptors is told as that and ends with 2."""
    assert run(_app(error), ["x"]) == BAD_INPUT
    assert capsys.readouterr().err == f"error: {said}\n"


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM])
def test_signals_leave_nothing_behind(number: signal.Signals, tmp_path: Path) -> None:
    """A hang-up, a quit and a termination unwind: a temporary folder goes, the exit code tells the signal."""
    text = """
        import tempfile, time, typer, gyrowheel.cli.app as cli
        app = typer.Typer()
        @app.command()
        def verb() -> None:
            with tempfile.TemporaryDirectory():
                print("there", flush=True)
                time.sleep(600)
        cli.app = app
        import sys
        sys.argv = ["gyrowheel", "--"]
        cli.main()
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(text)],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # what runs in the background may ignore it
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "there\n"
    assert len(list(tmp_path.iterdir())) == 1
    process.send_signal(number)
    assert process.wait(240) == 128 + number
    assert not list(tmp_path.iterdir())


_STREAMS = """
    import os, sys
    import typer
    from gyrowheel.cli.console import out, put_json, run
    from gyrowheel_core.errors import InputError

    app = typer.Typer()

    @app.command()
    def verb(how: str) -> None:
        if how == "bad":
            raise InputError("no such recording")
        if how == "defect":
            raise KeyError("x")
        with open(sys.argv[2], "wb") as file:
            assert file.fileno() > 2
        for _ in range(100_000 if how != "once" else 1):
            put_json("-", {"line": 1}) if how == "json" else out().print("line")

    sys.exit(run(app, sys.argv[1:2]))
"""


@pytest.mark.slow
def test_closed_streams_and_readers_that_end(tmp_path: Path) -> None:
    """No file takes the place of a closed stream; a reader that has had enough is no finding, and no success.

    Nor is an error where standard error takes nothing.
    """
    script = tmp_path / "verb.py"
    script.write_text(textwrap.dedent(_STREAMS))
    command = f"{sys.executable} {script}"
    for way, code in (
        (f"{command} once {tmp_path}/a >&-", 0),
        (f"{command} once {tmp_path}/a <&- >&- 2>&-", 0),
        (f"{command} text {tmp_path}/a | head -1; exit ${{PIPESTATUS[0]}}", 141),
        (f"{command} json {tmp_path}/a | head -1; exit ${{PIPESTATUS[0]}}", 141),
        # an error that cannot be told is no finding, either
        (f"{command} bad {tmp_path}/a 2>/dev/full", 2),
        (f"{command} bad {tmp_path}/a 2>&1 >/dev/null | true; exit ${{PIPESTATUS[0]}}", 2),
        (f"{command} defect {tmp_path}/a 2>/dev/full", 70),
    ):
        environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
        done = subprocess.run(
            ["bash", "-c", way], capture_output=True, text=True, check=False, env=environment
        )
        assert (done.returncode, done.stderr) == (code, ""), way


@pytest.mark.parametrize("columns", ["0", "1"])
def test_a_terminal_without_columns_loses_nothing(columns: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    assert _console(stderr=False).width >= 40
