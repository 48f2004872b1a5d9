"""Start of a node's process, alone and as a fork of a launcher."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gyrowheel_core.start_node import NodeRequest, command

START = (sys.executable, "-m", "gyrowheel_core.start_node")


def test_sigint_during_the_imports_ends_a_node_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text("import time\nprint('importing', flush=True)\ntime.sleep(60.0)\n")
    node = subprocess.Popen(
        [*START, "slow"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert node.stdout is not None
    assert node.stdout.readline() == "importing\n"
    node.send_signal(signal.SIGINT)
    _, said = node.communicate(timeout=30.0)
    assert (node.returncode, said) == (-signal.SIGINT, "")


def test_main_of_the_module_runs_with_the_arguments_after_its_name(tmp_path: Path) -> None:
    (tmp_path / "node.py").write_text(
        "import signal, sys\n"
        "def main():\n"
        "    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
        "    print(sys.argv[1:])\n"
        "    return 3\n"
    )
    ran = subprocess.run(
        [*START, "node", "--a", "b"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stdout) == (3, "['--a', 'b']\n")


def test_usage_is_printed_without_a_module() -> None:
    ran = subprocess.run(START, capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    assert ran.stderr.startswith("usage: ")


SHARED = "import os\nLOADED_BY = os.getpid()\n"
THREAD = "import threading, time\nthreading.Thread(target=time.sleep, args=(1.0,)).start()\n"
#: A node that prints what it is, and ends as its argument says.
FORKED = """
import os, shared, signal, sys, threading, time
def main():
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    tasks = len(os.listdir("/proc/self/task"))
    parent = os.environ["GYROWHEEL_PARENT"] == str(os.getppid()) == str(shared.LOADED_BY)
    print(sys.argv[1:], sys.stdin.read(), os.getsid(0) == os.getpid(), tasks, parent, flush=True)
    print("an error", file=sys.stderr)
    if sys.argv[1] == "waits":
        time.sleep(240.0)
    return int(sys.argv[1])
"""


def launch(
    folder: Path, *arguments: str, shared: str = "import os\nLOADED_BY = os.getpid()\n"
) -> subprocess.Popen[bytes]:
    (folder / "shared.py").write_text(shared)
    (folder / "forked.py").write_text(FORKED)
    nodes = [
        NodeRequest(module="forked", arguments=[argument, "b c"], log=str(folder / f"{argument}.log"))
        for argument in arguments
    ]
    environment = os.environ | {
        "PYTHONPATH": str(folder),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    return subprocess.Popen(
        command("shared", nodes),
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def wait_until_gone(pid: int) -> None:
    end = time.monotonic() + 120.0
    while Path(f"/proc/{pid}").exists():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_forked_nodes_end_as_nodes_that_are_started_alone(tmp_path: Path) -> None:
    """Arguments, output, session, threads, exit codes and the command line are those of a process of its own."""
    with launch(tmp_path, "0", "3", "waits") as launcher:
        assert launcher.stdout is not None
        pids = [int(launcher.stdout.readline()) for _ in range(3)]
        ended = dict(launcher.stdout.readline().split() for _ in range(2))
        assert ended == {b"%d" % pids[0]: b"0", b"%d" % pids[1]: b"3"}
        log = tmp_path / "waits.log"
        while not log.exists() or "\n" not in log.read_text():
            time.sleep(0.02)
        words = Path(f"/proc/{pids[2]}/cmdline").read_bytes().rstrip(b"\0").split(b"\0")
        assert words == [b"python3", b"-P", b"-m", b"gyrowheel_core.start_node", b"forked", b"waits", b"b c"]
        os.kill(pids[2], signal.SIGTERM)
        assert launcher.stdout.readline().split() == [b"%d" % pids[2], b"-15"]
        assert launcher.wait(120.0) == 0
    for name in ("0", "3", "waits"):
        lines = (tmp_path / f"{name}.log").read_text().splitlines()
        assert f"['{name}', 'b c']  True 1 True" in lines
        assert name == "waits" or "an error" in lines


@pytest.mark.slow
@pytest.mark.parametrize("how", ["closed", "killed"])
def test_the_launcher_ends_with_its_starter(how: str, tmp_path: Path) -> None:
    launcher = launch(tmp_path, "waits")
    assert launcher.stdin is not None
    assert launcher.stdout is not None
    pid = int(launcher.stdout.readline())
    if how == "closed":
        launcher.stdin.close()
    else:
        launcher.kill()
    assert launcher.wait(120.0) == (1 if how == "closed" else -signal.SIGKILL)
    os.kill(pid, signal.SIGKILL)  # a node of the bench looks for its parent
    wait_until_gone(pid)


@pytest.mark.parametrize("shared", ["import rclpy\n", THREAD], ids=["rclpy", "thread"])
def test_nothing_is_forked_where_the_launcher_has_threads(shared: str, tmp_path: Path) -> None:
    output, errors = launch(tmp_path, "0", shared=shared).communicate(timeout=240.0)
    assert output == b""
    assert b"shared imports rclpy or starts threads" in errors
