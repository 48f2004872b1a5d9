"""Recordings of two machines, told apart by the inertias that precession and ramps of the speed give."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mislabelled.blocks import Averages
from gyrowheel_recording.mislabelled.fixes import WrongSetup
from gyrowheel_recording.mislabelled.relations import Ratio, precession_ratio, spin_up_ratio
from gyrowheel_sim.bench import Bench

#: Inertias of one machine differ by less, whatever its effects: heated coils change their torque by a tenth.
_DIFFERENT = math.log(1.28)
_CERTAIN = 8.0  # standard errors


def other_machines(
    recordings: Sequence[Recording], averages: Sequence[Averages], bench: Bench
) -> list[WrongSetup]:
    """Return the recordings that state another machine than an earlier one, or show other inertias than one.

    Where both state their machine, nothing else is asked.

    Parameters
    ----------
    recordings : sequence of Recording
        The recordings, their setups right.
    averages : sequence of Averages
        Of each recording.
    bench : Bench
        The bench as stated; what is compared are its inertias as each recording shows them.
    """
    found = []
    known: list[tuple[Recording, tuple[Ratio, ...]]] = []
    for recording, own in zip(recordings, averages, strict=True):
        shown = precession_ratio(own, bench), spin_up_ratio(own, bench)
        for other, theirs in known:
            if recording.machine and other.machine:
                if recording.machine != other.machine:
                    found.append(_another(recording, other))
                    break
                continue
            far = [_distance(one, two) for one, two in zip(shown, theirs, strict=True)]
            if max(far) > 0.0:
                place = far.index(max(far))
                found.append(_another(recording, other, shown[place].value / theirs[place].value))
                break
        known.append((recording, shown))
    return found


def _another(recording: Recording, other: Recording, ratio: float = math.nan) -> WrongSetup:
    return WrongSetup(
        "another_machine",
        ("rotor inertia",),
        value=ratio,
        recording=str(recording.path),
        unit=str(other.path),
    )


def _distance(one: Ratio, other: Ratio) -> float:
    """Return by how much two inertias certainly differ (logarithm of their ratio); 0 where they may be equal."""
    if not (one.value > 0.0 and other.value > 0.0):
        return 0.0
    apart = abs(math.log(one.value / other.value))
    error = math.hypot(one.error / one.value, other.error / other.value)
    return apart if apart > _DIFFERENT and apart > _CERTAIN * error else 0.0
