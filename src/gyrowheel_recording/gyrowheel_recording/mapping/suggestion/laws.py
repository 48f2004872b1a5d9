"""Laws of the wheel that a table breaks grossly, where no plain change of its columns would mend it."""

from __future__ import annotations

from typing import Final

from threadpoolctl import threadpool_limits

from gyrowheel_recording.bags import Recording
from gyrowheel_recording.mapping.suggestion.records import Problem
from gyrowheel_recording.mislabelled.blocks import COIL, TILT, Averages, averages, blocks_of, never_measured
from gyrowheel_recording.mislabelled.relations import precession, slews, spin
from gyrowheel_sim.bench import Bench

#: Parts of a voltage and of the coils' torque that no effect, no tolerance and no noise leaves unexplained.
_VOLTAGE: Final = 0.3
_TORQUE: Final = 0.6


def broken_laws(recording: Recording, bench: Bench) -> list[Problem]:
    """Return the laws that the readings of a table do not obey, as questions.

    They are asked where `setups` found nothing to change: a column may be something else than it is called, such as the
    voltage of the supply or a duty cycle in the place of the motor's voltage.
    """
    absent = never_measured(recording)
    with threadpool_limits(limits=1, user_api="blas"):
        now = averages(blocks_of(recording, absent=absent), absent)
        found = []
        voltage = spin(now, bench).electrical if len(now) else 0.0
        if voltage > _VOLTAGE:
            found.append(
                Problem(
                    f"motor_voltage: {voltage:.0%} of it goes neither with the speed nor with the current, as that of "
                    f"a motor does on the bench {bench.name}, and no other unit, sign or column would mend it.",
                    "Is it the voltage at the motor, not that of a supply or a duty cycle? Name the right column, or "
                    "leave it out.",
                )
            )
        # the coils hold more than the tilt needs while a rate table turns
        turned = any(event.table_rate for event in recording.environment)
        torque = 0.0 if turned or not _judged(now, bench) else precession(now, bench)
        if torque > _TORQUE:
            found.append(
                Problem(
                    f"tilts and coil voltages: precession leaves {torque:.0%} of the coil torque unexplained, and no "
                    "other unit, sign or column would mend it.",
                    "Are they what they are called, and of this bench? Name the right columns.",
                )
            )
    return found


def _judged(now: Averages, bench: Bench) -> bool:
    """Whether the law of precession can be asked."""
    return bool(len(now)) and now.measured(*TILT) and not now.absent >= set(COIL) and slews(now, bench)
