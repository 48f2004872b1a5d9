"""How the process of a node begins, and how it ends before it is there."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

START = (sys.executable, "-m", "gyrowheel_core.start_node")


def test_a_node_that_is_interrupted_while_it_imports_just_ends(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text("import time\nprint('importing', flush=True)\ntime.sleep(60.0)\n")
    node = subprocess.Popen(
        [*START, "slow"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert node.stdout is not None
    assert node.stdout.readline() == "importing\n"
    node.send_signal(signal.SIGINT)
    _, said = node.communicate(timeout=30.0)
    assert (node.returncode, said) == (-signal.SIGINT, "")


def test_a_module_runs_with_the_arguments_behind_its_name(tmp_path: Path) -> None:
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


def test_without_a_module_it_says_what_is_missing() -> None:
    ran = subprocess.run(START, capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    assert ran.stderr.startswith("usage: ")
