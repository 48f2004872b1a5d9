"""Long arrays block by block."""

import errno
import mmap
import os
import threading
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from gyrowheel_core import arrays, cache
from gyrowheel_core.arrays import by_blocks, running_mean, zeros


@pytest.mark.parametrize("count", [0, 1, 9, 10, 11, 95])
def test_blocks_cover_every_row_once_and_in_order(count: int) -> None:
    found = by_blocks(count, lambda first, last: list(range(first, last)), rows=10)
    assert [row for part in found for row in part] == list(range(count))
    assert all(len(part) == 10 for part in found[:-1])


def test_error_of_a_block_is_raised_and_no_thread_is_left() -> None:
    before = threading.active_count()

    def work(first: int, last: int) -> None:
        if first >= 20:
            raise ValueError(first)

    with pytest.raises(ValueError, match="20"):
        by_blocks(100, work, rows=10)
    assert threading.active_count() == before


@pytest.mark.parametrize("size", [1, 7, 40])
@pytest.mark.parametrize(("beyond", "mode"), [("edge", "nearest"), ("symmetric", "reflect")])
def test_running_mean_is_that_of_scipy(size: int, beyond: Literal["edge", "symmetric"], mode: str) -> None:
    values = np.random.default_rng(1).standard_normal(60)
    assert running_mean(values, size, beyond) == pytest.approx(
        uniform_filter1d(values, size, mode=mode), abs=1e-12
    )


@pytest.fixture
def large_from_80_bytes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    monkeypatch.setattr(arrays, "IN_MEMORY", 79)
    return tmp_path


def test_a_large_array_lies_in_a_file_that_has_no_name(large_from_80_bytes: Path) -> None:
    small, large = (zeros(count, np.dtype(np.float64)) for count in (9, 10))
    assert small.base is None
    assert isinstance(large.base, mmap.mmap)
    assert not large.any()
    large[:] = 1.0
    assert large.sum() == 10.0
    assert not list(large_from_80_bytes.iterdir())


def test_a_large_array_lies_in_memory_where_the_disk_is_full(
    large_from_80_bytes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    assert zeros(10, np.dtype(np.float64)).base is None
