"""Where /dev/shm is missing, full or read-only, what runs in several processes elsewhere runs in one, and says so."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from .helpers import DRAG_PLAN, OTHER_PLAN, write

#: The command line in a process of its own, in which no semaphore can be made.
_COMMAND = """
    import _multiprocessing, os, sys

    class Refused:
        SEM_VALUE_MAX = 2**31 - 1
        def __init__(self, *_):
            raise OSError({0}, os.strerror({0}))

    _multiprocessing.SemLock = Refused
    from gyrowheel.campaigns import api
    from gyrowheel.campaigns.judge import Judged

    def made_up(keep, case, *_):
        return Judged(case.index, case.kind, {{}}, {{}}, True, "effect", [], [], "exact")

    api.run_case = made_up
    from gyrowheel.cli.app import main
    main()
"""


@pytest.mark.study  # test_cfd_sweep.py runs the same engine without them
@pytest.mark.slow
def test_a_campaign_without_semaphores(tmp_path: Path) -> None:
    code = errno.ENOSPC
    plans = [write(tmp_path / f"{name}.yaml", text) for name, text in (("a", DRAG_PLAN), ("b", OTHER_PLAN))]
    command = [sys.executable, "-c", textwrap.dedent(_COMMAND).format(code), "campaign", "--cases", "2"]
    command += ["--plan", str(plans[0]), "--validation-plan", str(plans[1]), "-o", str(tmp_path / "out")]
    why = f"no semaphore can be made in /dev/shm: {os.strerror(code)}"

    refused = subprocess.run([*command, "--jobs", "2"], capture_output=True, text=True, check=False)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == f"error: jobs: 2 is out of range; allowed: 1, since {why}\n"
    assert not (tmp_path / "out").exists()

    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"one at a time: {why}\n" in done.stderr
    assert "Warning" not in done.stderr
