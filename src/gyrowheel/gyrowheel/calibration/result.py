"""Calibrated constants of coils and motor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from gyrowheel.show.result import Result

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrowheel.models.api import Model
    from gyrowheel_analysis.calibrate import Calibration as Details
    from gyrowheel_analysis.calibrate import Constant
    from gyrowheel_recording.mislabelled.fixes import WrongSetup


@dataclass(frozen=True, repr=False)
class Calibration(Result):
    """Outcome of `gyrowheel.calibrate`.

    Attributes
    ----------
    details : gyrowheel_analysis.calibrate.Calibration
        The result of the analysis package, in full.
    setup : tuple of WrongSetup
        Columns that cannot be what they are called; then nothing else here is worth anything.
    """

    details: Details
    setup: tuple[WrongSetup, ...] = ()

    @property
    def constants(self) -> Mapping[str, Constant]:
        """Constants determined [SI]: ``.stated``, ``.before`` and ``.after``, each with value and standard error."""
        return MappingProxyType(self.details.constants)

    @property
    def undetermined(self) -> Mapping[str, str]:
        """Constants that were not determined, with the reason."""
        return MappingProxyType(self.details.undetermined)

    @property
    def model(self) -> Model:
        """A new model with these constants."""
        from gyrowheel.models.api import Model

        return Model.of(self.details.model)

    def __str__(self) -> str:
        """Return the constants, one per line."""
        from gyrowheel.show.quantities import with_error

        lines = [
            f"{name} = {with_error(c.after.value, c.after.standard_error, c.unit)}"
            for name, c in self.constants.items()
        ]
        lines += [f"{name}: not determined: {reason}" for name, reason in self.undetermined.items()]
        return "\n".join(lines)

    def page(self) -> Iterable[RenderableType]:
        """Return the page that `print` and a notebook show."""
        from gyrowheel.calibration.page import calibration_page

        return calibration_page(self.details)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``gyrowheel calibrate --json``, except whether it was written; SI units."""
        from gyrowheel.show.contract import calibration_json, setup_json

        more = {"model": self.details.model.origin, "setup": setup_json(self.setup)}
        return calibration_json(self.details) | more

    def to_columns(self) -> Mapping[str, Sequence[Any]]:
        """Return the constants as columns, a row for each; SI units."""
        rows = [
            (name, c.after.value, c.after.standard_error, c.unit, c.stated.value, c.stated.standard_error)
            for name, c in self.constants.items()
        ]
        names = ("constant", "value", "standard_error", "unit", "stated_value", "stated_uncertainty")
        return {name: [row[k] for row in rows] for k, name in enumerate(names)}
