"""Single setpoints of a running bench: their allowed range, and the plan that leads there from where the bench is."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

from gyrowheel_control.loops.supervision import usual_tilt_limit
from gyrowheel_control.plans.demands import USUAL_SHARE
from gyrowheel_control.plans.plan import as_text
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench

#: Rates of the way to a setpoint [deg/s], [rpm/s]: slower than those of plans, as nothing is measured there.
_TILT_RATE, _ACCELERATION = 2.0, 300.0
_PAUSE, _HOLD = 0.05, 1.0  # s, before the way there and after it
_DIGITS = 4  # after the point, of what is sent


@dataclass(frozen=True)
class Setpoint:
    """Tilts about x and y [deg], and spin rate [rpm]."""

    tilt_x: float
    tilt_y: float
    spin: float

    def words(self) -> str:
        """Return it in words."""
        return f"tilt {round(self.tilt_x, 3):g}, {round(self.tilt_y, 3):g}°, {round(self.spin, 1):g} rpm"


@dataclass(frozen=True)
class Allowed:
    """Range of the setpoints of a bench: largest tilt [deg], of both axes together, and spin rates [rpm]."""

    tilt: float
    slowest: float
    fastest: float

    @classmethod
    def of(cls, bench: Bench) -> Allowed:
        """Return the range of a bench."""
        ends = (bench.value(f"spin_rate_{end}") / RPM for end in ("minimum", "maximum"))
        return cls(usual_tilt_limit(bench) / DEG, *ends)

    @classmethod
    def described(cls, text: str) -> Allowed | None:
        """Return the range by the description that a bench publishes; None if it lacks a number."""
        try:
            parameters = json.loads(text)["parameters"]
            tilt, slowest, fastest = (
                float(parameters[name]["value"])
                for name in ("tilt_limit", "spin_rate_minimum", "spin_rate_maximum")
            )
        except (ValueError, KeyError, TypeError):
            return None
        good = 0.0 < tilt < math.pi and 0.0 <= slowest < fastest < math.inf
        return cls(USUAL_SHARE * tilt / DEG, slowest / RPM, fastest / RPM) if good else None

    def require(self, asked: Setpoint) -> None:
        """Check a setpoint; InputError that names field, value and allowed range."""

        def check(name: str, value: float, low: float, high: float, unit: str) -> None:
            if not low * (1.0 - 1e-9) <= value <= high * (1.0 + 1e-9):
                raise InputError(
                    f"{name}: {value:g} {unit} is not allowed; allowed: {low:.5g} .. {high:.5g} {unit}"
                )

        check("tilt about x", asked.tilt_x, -self.tilt, self.tilt, "deg")
        check("tilt about y", asked.tilt_y, -self.tilt, self.tilt, "deg")
        check("tilt of both axes together", math.hypot(asked.tilt_x, asked.tilt_y), 0.0, self.tilt, "deg")
        check("spin rate", asked.spin, self.slowest, self.fastest, "rpm")

    def plan(self, now: Setpoint, asked: Setpoint) -> str:
        """Return the text of the plan from one setpoint to another, after which the bench holds that.

        InputError where the bench turns at a speed from which no plan can begin.
        """
        self.require(asked)
        if not self.slowest <= now.spin <= self.fastest:
            raise InputError(
                f"bench: turns at {now.spin:.5g} rpm; a setpoint can be sent from {self.slowest:.5g} to "
                f"{self.fastest:.5g} rpm"
            )
        at, to = ([round(own.tilt_x, _DIGITS), round(own.tilt_y, _DIGITS)] for own in (now, asked))
        start = math.hypot(*at)
        return as_text(
            {
                "schema": 1,
                "name": "setpoint",
                "title": "A single setpoint",
                "tilt_rate_deg_s": _TILT_RATE,
                "spin_acceleration_rpm_s": _ACCELERATION,
                "start_tilt_deg": at,
                # a plan before may have ended beyond the usual limit
                **({"tilt_limit_deg": round(start, _DIGITS) + 1e-3} if start > self.tilt else {}),
                "segments": [
                    {"spin_rpm": round(now.spin, _DIGITS), "tilt_deg": at, "hold_s": _PAUSE},
                    {"spin_rpm": round(asked.spin, _DIGITS), "tilt_deg": to, "hold_s": _HOLD},
                ],
            }
        )


#: Reads the fields of a form.
Read = Callable[[str, str], float]


def read_setpoint(given: dict[str, str], read: Read) -> Setpoint:
    """Return the setpoint of a form; `read` turns a field with its name for people into a number."""
    return Setpoint(
        read("tilt about x", given["tilt_x"]),
        read("tilt about y", given["tilt_y"]),
        read("spin rate", given["spin"]),
    )
