"""A node as a process: environment, signals, exit codes; without any other node."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.exceptions import InvalidHandle

from gyrowheel_core.node import (
    BenchNode,
    ExitCode,
    StopSignals,
    prepare_environment,
    priority,
    run_node,
    spin,
)
from gyrowheel_core.node.priority import raise_priority

from ..domains import next_domain

RANGE, PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class NothingNode(BenchNode):
    """Does nothing."""

    NODE_NAME = "nothing"


@pytest.fixture
def _handlers_kept() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_discovery_stays_on_this_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (RANGE, PROFILES, "SKIP_DEFAULT_XML_FILE"):
        monkeypatch.setenv(name, "")  # so that both are put back afterwards
        monkeypatch.delenv(name)
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    for _ in range(2):  # also in a process that inherits it
        prepare_environment()
        assert os.environ[RANGE] == "SYSTEM_DEFAULT"  # that of the file, which names the loopback alone
        text = Path(os.environ[PROFILES]).read_text(encoding="utf-8")
        assert set(re.findall(r"<address>(.*?)</address>", text)) == {"127.0.0.1"}
        assert os.environ["SKIP_DEFAULT_XML_FILE"] == "1"  # of the current folder


@pytest.mark.parametrize("name", ["RMW_IMPLEMENTATION", PROFILES])
def test_another_middleware_or_a_file_of_the_user_has_the_range_of_ros(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    resources = tmp_path / "share/ament_index/resource_index/rmw_typesupport"
    resources.mkdir(parents=True)
    mine = tmp_path / "mine.xml"
    for file in (mine, resources / "rmw_other_cpp"):
        file.touch()
    value = str(mine) if name == PROFILES else "rmw_other_cpp"
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    for variable in (RANGE, PROFILES):
        monkeypatch.setenv(variable, "")
        monkeypatch.delenv(variable)
    monkeypatch.setenv(name, value)
    prepare_environment()
    assert os.environ[RANGE] == "LOCALHOST"
    assert os.environ[name] == value


def test_settings_of_the_user_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RANGE, "SUBNET")
    monkeypatch.setenv(PROFILES, "")
    monkeypatch.delenv(PROFILES)
    prepare_environment()
    assert os.environ[RANGE] == "SUBNET"
    assert PROFILES not in os.environ


@pytest.mark.usefixtures("_handlers_kept")
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_stops_a_node_that_starts_later(number: signal.Signals) -> None:
    class Stopped:
        stops = 0

        def stop(self) -> None:
            self.stops += 1

    signals, node = StopSignals(), Stopped()
    assert not signals.received
    os.kill(os.getpid(), number)
    assert signals.received
    signals.attach(node)
    assert node.stops == 1
    os.kill(os.getpid(), number)
    assert node.stops == 2


def test_help_exits_with_success(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_node(NothingNode, ["--help"]) == ExitCode.OK
    assert capsys.readouterr().out.startswith("Does nothing.\n")


@pytest.mark.usefixtures("_handlers_kept")
@pytest.mark.parametrize("arguments", [["more"], ["--ros-args", "-p", "no assignment"]])
def test_bad_arguments_end_with_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_node(NothingNode, arguments) == ExitCode.BAD_INPUT
    said = capsys.readouterr().err
    assert said.startswith("nothing: ")
    assert said.count("\n") == 1


def test_priority_zero_changes_nothing() -> None:
    before = os.sched_getscheduler(0)
    assert raise_priority(0)
    assert os.sched_getscheduler(0) == before


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads have no names here")
def test_the_resending_thread_does_not_occupy_the_core_of_a_reader(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: dict[int, int] = {}
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda thread, _, own: given.update({thread: own.sched_priority})
    )
    end = threading.Event()
    sender = threading.Thread(target=end.wait, daemon=True)
    sender.start()
    Path(f"/proc/self/task/{sender.native_id}/comm").write_text("dds.asyn.0.0", encoding="utf-8")
    try:
        assert raise_priority(10)
    finally:
        end.set()
        sender.join()
    assert sender.native_id not in given  # it stays with the ordinary ones
    assert given[os.getpid()] == 10


def test_a_user_defined_node_has_its_requested_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def keep_pace(level: int) -> dict[str, str]:
        asked.append(level)
        return {}

    monkeypatch.setattr(priority, "keep_pace", keep_pace)
    prepare_environment()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=next_domain())
    node = rclpy.create_node("mine", context=context)
    end = threading.Timer(0.3, lambda: rclpy.shutdown(context=context))
    end.start()
    spin(node, priority=7)
    end.join()
    assert asked == [7]
    with pytest.raises(InvalidHandle):  # destroyed
        node.get_namespace()


def test_a_refused_priority_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert not raise_priority(10)


def test_a_refused_priority_is_in_the_diagnostics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(priority, "raise_priority", lambda level: level < 30)
    monkeypatch.setattr(priority, "lock_memory", lambda: False)
    assert priority.keep_pace(0) == {}
    assert priority.keep_pace(20)["priority"] == "20"
    values = priority.keep_pace(30)
    assert priority.is_refused(values)
    assert values["memory_locked"].startswith("not allowed")


def test_memory_is_locked_only_without_a_limit() -> None:
    """Below one the next allocation would fail; the process goes on in either case."""
    lines = """
        import resource
        from pathlib import Path
        from gyrowheel_core.node import priority

        if {limited}:
            resource.setrlimit(resource.RLIMIT_MEMLOCK, (1 << 16, 1 << 16))
            priority._has_capability = lambda number: False
        locked = priority.lock_memory()
        block = bytearray(1 << 25)
        kept = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmLck"))
        print(locked, int(kept.split()[1]) > 0)
    """
    found = []
    for limited in (True, False):
        code = textwrap.dedent(lines).replace("{limited}", str(limited))
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        found.append(done.stdout.strip())
    assert found[0] == "False False"
    assert found[1] in ("True True", "False False")  # as the system allows


def test_exit_codes_of_nodes_differ_from_findings_and_interruptions() -> None:
    shell = pytest.importorskip("gyrowheel.cli.console")
    assert {shell.FINDING, shell.INTERRUPTED}.isdisjoint({int(code) for code in ExitCode})
    assert (ExitCode.BAD_INPUT, ExitCode.FAULT, ExitCode.CRASH) == (
        shell.BAD_INPUT,
        shell.NODE_FAILED,
        shell.INTERNAL_ERROR,
    )
