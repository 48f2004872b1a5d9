"""The end of a node whose middleware crashes or hangs as it is taken apart."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gyrowheel_bringup.graph.processes import Child, is_stopped
from gyrowheel_core.node import TORN

from ..domains import next_domain
from .helpers import wait_for

NODE = """
import ctypes, os, signal, sys
from gyrowheel_core.node import BenchNode, NodeStatus, process, run_node

process.CLEANED_UP, process.DESTROYED = 2, 1  # s

class Fragile(BenchNode):
    NODE_NAME = "fragile"

    def activate(self):
        print("active", flush=True)
        if "activate" in sys.argv:
            ctypes.PyDLL(None).pause()

    def cleanup(self):
        print("work done", flush=True)
        if "early" in sys.argv:
            os.kill(os.getpid(), signal.SIGSEGV)
        if "cleanup" in sys.argv:
            ctypes.PyDLL(None).pause()

    def destroy_node(self):
        if "exit" in sys.argv:
            system = ctypes.CDLL(None)
            system["__cxa_atexit"](system["raise"], ctypes.c_void_p(signal.SIGABRT), None)
        if {"well", "exit"} & {*sys.argv}:
            return super().destroy_node()
        if "hangs" in sys.argv:
            ctypes.PyDLL(None).pause()  # which keeps Python's lock
        os.kill(os.getpid(), signal.SIGSEGV)

code = run_node(Fragile, [])
print(signal.alarm(0), "left", flush=True)
raise SystemExit(code)
"""


@pytest.mark.graph
@pytest.mark.parametrize("when", ["early", "late", "hangs", "cleanup", "exit", "well"])
def test_a_crash_counts_before_the_work_is_done_and_not_after(when: str, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", NODE, when],
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"active\n"
    process.send_signal(signal.SIGINT)
    said = process.stdout.read()
    code = process.wait(240.0)
    child = Child("fragile", process.pid, tmp_path / "log", returncode=code, expected=True)
    assert said == b"work done\n" + (b"0 left\n" if when in ("exit", "well") else b"")
    if when == "well":
        assert code == 0
    elif when == "early":
        assert code == -signal.SIGSEGV
        assert not child.ended_well
    else:
        assert code in TORN
        assert (code == signal.SIGALRM) == (when in ("hangs", "cleanup"))
        assert child.ended_well
        child.expected = False
        assert not child.ended_well


@pytest.mark.graph
def test_a_node_that_hangs_logs_where_before_it_is_killed() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", NODE, "activate"],
        env=os.environ | {"ROS_DOMAIN_ID": str(next_domain())},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "active\n"
    process.send_signal(signal.SIGQUIT)
    _, log = process.communicate(timeout=60.0)
    assert process.returncode == -signal.SIGQUIT
    assert "in activate" in log


def test_a_node_that_was_stopped_when_it_had_to_end_did_not_end_well(tmp_path: Path) -> None:
    with subprocess.Popen(["sleep", "1000"]) as process:
        try:
            assert not is_stopped(process.pid)
            process.send_signal(signal.SIGSTOP)
            wait_for(lambda: is_stopped(process.pid))
        finally:
            process.kill()
    assert not is_stopped(process.pid)
    child = Child("recorder", process.pid, tmp_path / "log", returncode=0, expected=True, stopped=True)
    assert not child.ended_well
    assert child.ending == "stopped by a signal, such as SIGSTOP, and not continued"


@pytest.mark.skipif(not shutil.which("strace"), reason="needs strace")
def test_a_node_whose_system_calls_are_traced_is_not_stopped() -> None:
    code = "import os\nprint(os.getpid(), flush=True)\nwhile True: os.access('/', os.F_OK)"
    traced = ["strace", "-qq", "-e", "trace=access", "-o", os.devnull, sys.executable, "-c", code]
    with subprocess.Popen(traced, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            pytest.skip("tracing is not allowed")
        pid = int(line)
        try:
            assert not any(is_stopped(pid) for _ in range(200))
            os.kill(pid, signal.SIGSTOP)
            wait_for(lambda: is_stopped(pid))
        finally:
            os.kill(pid, signal.SIGKILL)
