"""What several files of these tests need: a run in memory, and the recording of it."""

from __future__ import annotations

import pytest

from gyrowheel_recording.bags import write_run
from tests.recording.recordings import make_run


@pytest.fixture(scope="session")
def run():
    return make_run()


@pytest.fixture(scope="session")
def directory(run, tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("recording") / "run", **run)
