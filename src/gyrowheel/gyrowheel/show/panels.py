"""Which signals of a recording are drawn, in which panels and units: in pictures, reports and on the workbench."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gyrowheel_core.units import DEG, RPM

#: Title with unit, size of the unit, columns with their labels.
PANELS: tuple[tuple[str, float, Mapping[str, str]], ...] = (
    ("tilt, °", DEG, {"tilt_x": "about x", "tilt_y": "about y"}),
    ("spin rate, rpm", RPM, {"spin_rate": "spin rate"}),
    ("coil voltage, V", 1.0, {"coil_voltage_x": "coil x", "coil_voltage_y": "coil y"}),
    ("motor voltage, V", 1.0, {"motor_voltage": "motor"}),
    ("motor current, A", 1.0, {"motor_current": "motor"}),
)


def columns() -> Iterator[tuple[str, float]]:
    """Yield the columns of `PANELS` with the sizes of their units."""
    for _, size, names in PANELS:
        for name in names:
            yield name, size
