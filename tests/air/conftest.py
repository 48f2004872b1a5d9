"""A player of recorded runs on the PATH."""

from __future__ import annotations

from pathlib import Path

import pytest

from .helpers import Player


@pytest.fixture
def player(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Player:
    result = Player(tmp_path / "programs")
    monkeypatch.setenv("PATH", result.search_path)
    return result
