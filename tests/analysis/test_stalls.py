"""A bench that stood still: no sample is missing, and the stamps go on later."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrowheel.recordings.page import integrity_text
from gyrowheel_core import wire
from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.live import StallCount
from tests.recording.recordings import record

PERIOD = 500_000


@given(
    st.lists(st.tuples(st.integers(1, 40), st.integers(10, 4000)), max_size=4),
    st.lists(st.integers(-50_000, 50_000), min_size=200, max_size=200),
)
def test_the_recorder_finds_every_stall_and_nothing_else(
    stalls: list[tuple[int, int]], jitter: list[int]
) -> None:
    watch = StallCount()
    stamps = np.arange(200) * PERIOD + np.array(jitter)
    place = 0
    for after, periods in stalls:
        place += after
        stamps[place + 2 :] += periods * PERIOD
    for sequence, stamp in enumerate(stamps.tolist()):
        watch.add(stamp, sequence + 7)
    assert watch.number == len(stalls)
    if stalls:
        assert float(watch.last.split()[2]) == pytest.approx(stalls[-1][1] * 5e-4, abs=1e-3)


def test_missing_samples_are_no_stall() -> None:
    watch = StallCount()
    for sequence in (0, 1, 2, 3, 900, 901):
        watch.add(sequence * PERIOD, sequence)
    assert watch.number == 0


def test_recording_lists_the_times_of_stalls(tmp_path) -> None:
    stood = 295_000_000
    messages = [
        wire.MEASUREMENT.pack(k * PERIOD + (stood if k > 100 else 0), k, *[0.5 * k] * 11) for k in range(200)
    ]
    found = Recording.open(record(tmp_path / "run", messages)).integrity()
    (stall,) = found.stalls
    assert stall == pytest.approx((0.05, 0.295))
    assert found.complete
    assert integrity_text(found) == "complete; the bench stood still 0.295 s at 0.1 s"
