"""Long arrays block by block."""

import threading

import pytest

from gyrowheel_core.arrays import by_blocks


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
