"""Torque of the air on the tilted, spinning rotor: one interface, four models.

========== ===================================================== =====================================
model      what it is                                            says nothing of
========== ===================================================== =====================================
correlation published drag of discs and cylinders                the transverse torques
vorticity  end-gap vorticity for the restoring torque, drag as   the torque across the tilt
           above
table      computed torques, interpolated                        tilts and speeds outside of the table
surrogate  power laws fitted to a table                          the same
========== ===================================================== =====================================
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gyrowheel_core.errors import InputError

if TYPE_CHECKING:
    from gyrowheel_air.table import TorqueTable
    from gyrowheel_air.torque import AirModel

MODELS = ("correlation", "vorticity", "table", "surrogate")


def get_model(name: str, table: TorqueTable | None = None) -> AirModel:
    """Return a model of the air by name.

    Parameters
    ----------
    name : str
        Of `MODELS`.
    table : TorqueTable, optional
        Table for ``table`` and ``surrogate``; the shipped one by default.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name in ("correlation", "vorticity"):
        from gyrowheel_air.correlations import Correlation, Vorticity

        return Correlation() if name == "correlation" else Vorticity()
    if name not in MODELS:
        raise InputError(f"air model: {name!r} is not known; allowed: {', '.join(MODELS)}")
    from gyrowheel_air.surrogate import fit_table
    from gyrowheel_air.table import Table, TorqueTable

    rows = TorqueTable.load() if table is None else table
    return Table(rows) if name == "table" else fit_table(rows)
