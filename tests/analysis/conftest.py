"""What several files of these tests need: a run in memory, the recording of it, and a separate cache."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from gyrowheel_core import cache
from gyrowheel_recording.bags import write_run
from tests.recording.recordings import make_run


@pytest.fixture(scope="session")
def run():
    return make_run()


@pytest.fixture(scope="session")
def directory(run, tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("recording") / "run", **run)


@pytest.fixture
def cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the folder of an empty cache, which is in use."""
    place = tmp_path / "cache"
    monkeypatch.setenv(cache.VARIABLE, str(place))
    yield place
    cache._folder.cache_clear()
