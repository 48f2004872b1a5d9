"""Wrong setups of a recording: looked for before anything is fitted to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from gyrowheel_recording.bags import Recording
from gyrowheel_recording.bags.sampling import require_rate
from gyrowheel_recording.mislabelled.air import air
from gyrowheel_recording.mislabelled.blocks import (
    COIL,
    TILT,
    Array,
    Averages,
    averages,
    block_times,
    blocks_of,
    never_measured,
)
from gyrowheel_recording.mislabelled.fixes import Cure, WrongSetup
from gyrowheel_recording.mislabelled.harmonics import harmonics
from gyrowheel_recording.mislabelled.machines import other_machines
from gyrowheel_recording.mislabelled.relations import precession, slews
from gyrowheel_recording.mislabelled.spin import SPINNING, spinning
from gyrowheel_recording.mislabelled.stuck import stuck
from gyrowheel_recording.mislabelled.tilt import tilting
from gyrowheel_sim.bench import Bench

_AROUND = 0.5  # s before and after a change of the rate table


def wrong_setups(recordings: Sequence[Recording], bench: Bench, *, mixed: bool = False) -> list[WrongSetup]:
    """Return the wrong setups of some recordings.

    A setup is accused only where physics fails far beyond what any effect or tolerance can do, and a plain change of
    the columns makes it hold.

    Parameters
    ----------
    recordings : sequence of Recording
        The recordings, each judged by itself.
    bench : Bench
        The bench as stated.
    mixed : bool
        Whether recordings of different machines are wanted; if not, their inertias must agree.

    Raises
    ------
    InputError
        If the samples of a recording are too far apart to say anything.
    """
    found, averaged = [], []
    # the matrices are small: several threads would only wait for each other
    with threadpool_limits(limits=1, user_api="blas"):
        for recording in recordings:
            wrong, now = _judged(recording, bench)
            found += [replace(item, recording=str(recording.path)) for item in wrong]
            averaged.append(now)
        if not found and len(recordings) > 1 and not mixed:
            found = other_machines(recordings, averaged, bench)
    return found


def of_one(recording: Recording, bench: Bench) -> list[WrongSetup]:
    """Return the wrong setups of one recording, see `wrong_setups`."""
    return wrong_setups([recording], bench)


def _judged(recording: Recording, bench: Bench) -> tuple[list[WrongSetup], Averages]:
    """Return the wrong setups of one recording, and its averages as they stand."""
    require_rate(recording)
    absent = never_measured(recording)
    blocks = blocks_of(recording, absent=absent)
    now = averages(_at_rest(recording, blocks), absent)
    still = stuck(recording, blocks, bench) if len(blocks) else []
    return [*air(recording, bench), *(still or _of_motion(recording, now, bench))], now


def _of_motion(recording: Recording, now: Averages, bench: Bench) -> list[WrongSetup]:
    """Return what is wrong with the columns that move."""
    if not len(now):
        return []
    wrong = spinning(recording, now, bench)
    if not wrong:
        return _of_tilt(recording, now, bench, 1.0)
    # where several changes explain the spin as well, the precession decides
    wrong.sort(key=lambda item: round(precession(item[1], bench), 1))
    others: list[WrongSetup] = []
    for own, mended in wrong:
        further = _of_tilt(recording, mended, bench, own.cure.scale.get(SPINNING[0], 1.0))
        if not further:
            return [own]
        others = others or further
    return [wrong[0][0], *others]


def _of_tilt(recording: Recording, now: Averages, bench: Bench, angle_factor: float) -> list[WrongSetup]:
    """Return what is wrong with tilts and coil voltages, or with the direction of the spin."""
    speed = now.rate[np.isfinite(now.rate)]
    if not len(speed) or np.median(speed) > 0.0:
        turning = harmonics(recording, angle_factor=angle_factor, absent=now.absent)
        return tilting(recording, now, bench, turning)
    if not now.measured(*TILT) or now.absent >= set(COIL) or not slews(now, bench):
        return []
    # the wheel turns the other way, or the signs of all that belongs to the spin are turned
    measured = [name for name in SPINNING if now.measured(name)]
    signs = Cure(scale=dict.fromkeys(measured, -1.0))
    mirror = Cure(scale=dict.fromkeys((TILT[1], COIL[1]), -1.0))
    own, other = (precession(a, bench) for a in (now, signs.applied(now)))
    if own < other:
        return [WrongSetup("reversed", SPINNING, signs.and_then(mirror), before=other, after=own)]
    return [WrongSetup("sign", SPINNING, signs, before=own, after=other)]


def _at_rest(recording: Recording, blocks: Array) -> Array:
    """Return the blocks in which no rate table turns the rig: the coils then hold more than the tilt needs."""
    if not any(event.table_rate for event in recording.environment):
        return blocks
    time = block_times(recording, len(blocks))
    turned = np.zeros(len(blocks), dtype=bool)
    for event in recording.environment:
        turned[time >= event.time - _AROUND] |= bool(event.table_rate)
        if not event.table_rate:
            turned[time >= event.time + _AROUND] = False
    return np.where(turned[:, None], np.nan, blocks)
