"""A segment of a plan: one ramp and the steady motion after it."""

from __future__ import annotations

from dataclasses import dataclass

from gyrowheel_sim.environment import Environment


@dataclass(frozen=True)
class Segment:
    """One ramp to a state and the steady motion after it [SI].

    Attributes
    ----------
    start, ramp, hold : float
        Start time, time of the ramp, and time of the steady motion [s].
    tilt_from, tilt : complex
        Tilt angles phi_x + i phi_y before and after the ramp [rad].
    spin_from, spin, spin_end : float
        Spin rate before and after the ramp, and at the end of the steady motion [rad/s].
    cone_rate : float
        Rate at which the tilt turns about the case axis during the steady motion [rad/s]; 0 for a hold.
    environment : Environment
        The environment in which it runs.
    label : str
        What it is called.
    block : int
        Number of the block of the plan file that it comes from.
    """

    start: float
    ramp: float
    hold: float
    tilt_from: complex
    tilt: complex
    spin_from: float
    spin: float
    spin_end: float
    cone_rate: float
    environment: Environment
    label: str
    block: int = 0

    @property
    def end(self) -> float:
        """End time [s]."""
        return self.start + self.ramp + self.hold
