"""What coils and motor hold, part by part."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from gyrowheel.models.api import Model
    from gyrowheel_analysis.torques import HoldTorques


@dataclass(frozen=True, repr=False)
class Torques(Result):
    """Outcome of `gyrowheel.torques`.

    Attributes
    ----------
    details : gyrowheel_analysis.torques.HoldTorques
        Holds and parts, arrays over the holds (n,); torques [N·m], complex numbers are x + i y in case axes.
    model : Model
        The model.
    recordings : tuple of str
        Paths of the recordings; empty if the holds were simulated.
    orbit : bool
        Whether they were simulated in orbit: without air, weight and the rate of the Earth.
    """

    details: HoldTorques
    model: Model
    recordings: tuple[str, ...]
    orbit: bool = False

    @property
    def remainder_coil(self) -> Any:
        """What the coils were measured to hold beyond the model [N·m], complex (n,); None without a recording."""
        measured = self.details.measured_coil
        return None if measured is None else measured - self.details.predicted_coil

    @property
    def remainder_motor(self) -> Any:
        """What the motor was measured to hold beyond the model [N·m], (n,); None without a recording."""
        measured = self.details.measured_motor
        return None if measured is None else measured - self.details.predicted_motor

    def __str__(self) -> str:
        """Return the largest torques and the smallest margins."""
        d, place = self.details, " in orbit" if self.orbit else ""
        lines = [
            f"{len(d)} holds{place}; coils hold up to {1e3 * np.abs(d.coil).max():.3g} mN·m, "
            f"motor up to {1e3 * np.abs(d.motor).max():.3g} mN·m"
        ]
        margins = ((d.coil_margin, "coils"), (d.motor_margin, "motor"), (d.tilt_margin, "tilt"))
        left = ", ".join(f"{name} {100.0 * float(margin.min()):.0f} %" for margin, name in margins)
        lines.append(f"  left to the limits: {left}")
        if self.remainder_coil is not None:
            lines.append(
                f"  beyond the model: coils {1e3 * np.abs(self.remainder_coil).max():.2g} mN·m, "
                f"motor {1e3 * np.abs(self.remainder_motor).max():.2g} mN·m at most"
            )
        return "\n".join(lines)

    def _page(self) -> Iterable[RenderableType]:
        from gyrowheel.torque_budget.page import torques_page

        return torques_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel torques --json``; SI units."""
        d = self.details

        def xy(value: complex) -> list[float]:
            return [float(np.real(value)), float(np.imag(value))]

        holds = []
        for k in range(len(d)):
            hold: dict[str, Any] = {
                "tilt": xy(d.tilt[k]),
                "spin_rate": float(d.spin_rate[k]),
                "coil_torque": xy(d.coil[k]),
                "motor_torque": float(d.motor[k]),
                "parts": {
                    part.name: {"coil": xy(part.coil[k]), "motor": float(part.motor[k])} for part in d.parts
                },
                "coil_voltage": xy(d.coil_voltage[k]),
                "motor_voltage": float(d.motor_voltage[k]),
                "margin": {
                    "coil": float(d.coil_margin[k]),
                    "motor": float(d.motor_margin[k]),
                    "tilt": float(d.tilt_margin[k]),
                },
            }
            if self.recordings:
                hold["measured"] = {
                    "coil": xy(d.measured_coil[k]),  # type: ignore[index]
                    "motor": float(d.measured_motor[k]),  # type: ignore[index]
                }
                hold["remainder"] = {
                    "coil": xy(self.remainder_coil[k]),
                    "motor": float(self.remainder_motor[k]),
                }
            holds.append(hold)
        return {
            "schema": 1,
            "model": self.model.origin,
            "recordings": list(self.recordings),
            "orbit": self.orbit,
            "holds": holds,
        }

    def to_columns(self) -> Mapping[str, Any]:
        """Return tilt [rad], spin rate [rad/s] and the torques of every part [N·m] as columns of shape (n,)."""
        d = self.details
        columns: dict[str, Any] = {
            "tilt_x": np.real(d.tilt), "tilt_y": np.imag(d.tilt), "spin_rate": d.spin_rate,
        }  # fmt: skip
        torques = [("all", d.coil, d.motor), *((part.name, part.coil, part.motor) for part in d.parts)]
        if self.recordings:
            torques.append(("remainder", self.remainder_coil, self.remainder_motor))
        for name, coil, motor in torques:
            columns |= {
                f"{name}_coil_x": np.real(coil),
                f"{name}_coil_y": np.imag(coil),
                f"{name}_motor": motor,
            }
        return columns

    def plot(self) -> Figure:
        """Return the parts stacked over spin rate or tilt: along the tilt, across it, and of the motor."""
        from gyrowheel.torque_budget.picture import figure_of_torques

        return figure_of_torques(self)
