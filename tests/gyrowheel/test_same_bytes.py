"""A recording simulated with one thread and with several is the same, byte for byte."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

_COMMAND = [sys.executable, "-c", "from gyrowheel.cli.app import main; main()"]
_PLAN = """\
schema: 1
name: short
hold_s: 1.0
segments:
  - {spin_rpm: [3500, 2000], tilt_deg: [[0, 0], [3, 0], [0, -2]]}
"""


@pytest.mark.study  # of computers that seldom differ
@pytest.mark.slow
def test_same_bytes_on_any_number_of_cores(tmp_path: Path) -> None:
    """Neither the threads of linear algebra nor the cores of the process leave a trace in the file."""
    (tmp_path / "short.yaml").write_text(_PLAN)
    digests = set()
    for number, threads in enumerate(("1", "4")):
        folder = tmp_path / str(number) / "run"
        environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads)
        cores = {min(os.sched_getaffinity(0))} if number == 0 else os.sched_getaffinity(0)
        subprocess.run(
            [
                *_COMMAND,
                "simulate",
                "--plan",
                str(tmp_path / "short.yaml"),
                "-o",
                str(folder),
                "--machine",
                "3",
            ],
            env=environment,
            check=True,
            capture_output=True,
            preexec_fn=lambda cores=cores: os.sched_setaffinity(0, cores),  # type: ignore[misc]
        )
        for file in sorted(folder.iterdir()):
            digests.add((file.name, hashlib.sha256(file.read_bytes()).hexdigest()))
    assert len(digests) == 2  # metadata.yaml and the messages
