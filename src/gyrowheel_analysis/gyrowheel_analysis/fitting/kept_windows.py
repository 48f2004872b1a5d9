"""Windows of recordings in the user's cache, so that a second verb on the same recording need not reduce it again.

An entry is found by everything that decides its content: all samples, commands and setpoints, the bench as stated, and
the code. So it is never out of date; a damaged one is computed again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gyrowheel_analysis.reduction.instrument_readings import Shown, look
from gyrowheel_analysis.reduction.samples import Samples
from gyrowheel_analysis.reduction.segmentation import reduce_and_account
from gyrowheel_analysis.reduction.windows import Coverage, Windows
from gyrowheel_core import cache
from gyrowheel_recording.bags import Recording
from gyrowheel_sim.bench import Bench

_PREFIX = "windows_"
_MOST = 200  # entries; one of an hour has some megabytes
#: Packages on which every kept result depends.
CODE = ("gyrowheel_core", "gyrowheel_sim", "gyrowheel_control", "gyrowheel_recording", "gyrowheel_analysis")


class Reduced(NamedTuple):
    """A reduced recording: its windows, their coverage, and the instruments as its samples show them."""

    windows: Windows
    coverage: Coverage
    shown: Shown


def reduced(recording: Recording, samples: Samples, bench: Bench) -> Reduced:
    """Return a reduced recording, from the cache if it was reduced before; `samples` are its columns."""
    key = cache.digest(cache.files_of(*CODE), np.__version__, recording.content, repr(bench.stated))

    def reduce_it() -> Reduced:
        windows, coverage = reduce_and_account(samples, bench)
        return Reduced(windows, coverage, look(samples, windows, bench))

    return cache.computed(_PREFIX, key, _MOST, reduce_it)
