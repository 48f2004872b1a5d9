"""Torque constants of coils and motor from recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from gyrowheel.models.api import Model
from gyrowheel.recordings.api import explained_by, wrong_setups
from gyrowheel.recordings.inputs import Recordings, Say, data, of_one_machine
from gyrowheel.show.result import Result, columns_of
from gyrowheel_analysis import calibrate as facts

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel_recording.mislabelled import WrongSetup


@dataclass(frozen=True, repr=False)
class Calibration(Result, facts.Calibration):
    """Outcome of `gyrowheel.calibrate`.

    The fields are those of `gyrowheel_analysis.calibrate.Calibration`, and one more.

    Attributes
    ----------
    setup : tuple of WrongSetup
        Columns that cannot be what they are called; if there are any, all other results are meaningless.
    """

    setup: tuple[WrongSetup, ...] = ()

    @property
    def model(self) -> Model:
        """A new model with these constants."""
        return Model.of(self.calibrated)

    def headline(self) -> str:
        """Return the constants with their standard errors."""
        from gyrowheel_core.quantities import with_error

        return ", ".join(
            f"{name} = {with_error(c.after.value, c.after.standard_error, c.unit)}"
            for name, c in self.constants.items()
        )

    def page(self) -> Iterable[RenderableType]:
        """Return the constants before and after, with what limits them."""
        from gyrowheel.calibration.page import calibration_page

        return calibration_page(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel calibrate --json``, except whether it was written; SI units."""
        from gyrowheel.show.contract import calibration_json, setup_json

        more = {"model": self.calibrated.origin, "setup": setup_json(self.setup)}
        return calibration_json(self) | more

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the constants as columns, a row for each; SI units."""
        return columns_of(
            "constant value standard_error unit stated_value stated_uncertainty",
            (
                (name, c.after.value, c.after.standard_error, c.unit, c.stated.value, c.stated.standard_error)
                for name, c in self.constants.items()
            ),
        )


def calibrate(
    recordings: Recordings, model: Model, *, mixed: bool = False, progress: Say | None = None
) -> Calibration:
    """Calibrate the torque constants of coils and motor.

    The reference of the coils is the angular momentum of the rotor: its precession takes a torque that follows from
    inertia and motion alone (plan ``cone``). The reference of the motor is voltage over speed (plan ``coast_down``).

    Parameters
    ----------
    recordings : Recording, path or list
        Recordings of one machine.
    model : Model
        The model; its effects are taken into account, its constants of coils and motor are not.
    mixed : bool
        Join recordings that state different machines.
    progress : callable, optional
        Called with a line of text now and then.

    Returns
    -------
    Calibration
        The constants; ``.model`` is a new model that has them.

    Raises
    ------
    InputError
        If there is too little steady motion, or nothing could be determined.
    """
    given = of_one_machine(recordings, mixed=mixed)
    wrong = wrong_setups(given, model.details, mixed=mixed)
    with explained_by(wrong):
        found = facts.calibrate(data(given), model.details, progress=progress)
    constants, missing = MappingProxyType(found.constants), MappingProxyType(found.undetermined)
    return Calibration.of(replace(found, constants=constants, undetermined=missing), setup=tuple(wrong))
