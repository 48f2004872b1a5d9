"""The picture of an error that falls."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrowheel.show.error_fall import error_figure
from gyrowheel.show.figure import write_figure
from gyrowheel_analysis.residuals.error_table import ErrorRow, ErrorTable, Residuals
from gyrowheel_core.errors import InputError

from ..letters import check_letters

TITLE = "An effect is missing: drag of the air on the spin"


def residuals(role: str, count: int = 12) -> Residuals:
    rng = np.random.default_rng(count)
    noise = np.full(count, 2e-5)
    channels = {
        name: (20.0 * noise * rng.normal(size=count), noise * rng.normal(size=count), noise)
        for name in ("tilt_x", "tilt_y", "spin")
    }
    time = np.linspace(1.0, 30.0, count)
    return Residuals(role, role, time, np.linspace(366.0, 150.0, count), np.zeros(count, complex), channels)


def row(size: float) -> ErrorRow:
    return ErrorRow({"tilt_x": size, "tilt_y": size, "spin": size}, size)


FIT, VALIDATION = residuals("fit"), residuals("validation", 5)
TABLE = ErrorTable(row(4e-4), row(2e-5), row(2e-5), row(3e-4), row(2e-5), row(2e-5))
FIT_ONLY = ErrorTable(row(4e-5), row(2e-5), row(2e-5))
ZERO = ErrorTable(row(0.0), row(0.0), row(0.0))


@pytest.mark.parametrize(
    ("parts", "table"),
    [
        ([FIT, VALIDATION], TABLE),
        ([FIT, replace(FIT, name="second"), VALIDATION], TABLE),
        ([FIT], FIT_ONLY),
        ([residuals("fit", 1)], ZERO),
    ],
    ids=["both", "two fitted", "fit only", "one window, no error"],
)
def test_picture_is_a_png_of_1600_by_1000_pixels(tmp_path: Path, parts: list[Residuals], table: ErrorTable):
    file = tmp_path / "new" / "picture.png"
    write_figure(error_figure(parts, table, title=TITLE, subtitle="w = 1.02 ± 0.05 mN·m"), file)
    content = file.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", content[16:24]) == (1600, 1000)
    assert len(content) < 300_000
    assert list(file.parent.iterdir()) == [file]


def test_failed_write_of_a_picture_leaves_no_file(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_figure(error_figure([FIT], FIT_ONLY, title=TITLE), tmp_path / "file" / "picture.png")
    (tmp_path / "folder").mkdir()
    with pytest.raises((InputError, OSError)):
        write_figure(error_figure([FIT], FIT_ONLY, title=TITLE), tmp_path / "folder")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]


@pytest.mark.slow
def test_long_titles_and_names_stay_within_the_picture_and_apart():
    effects = "; ".join(f"effect_number_{k}: C_x = 0.970 ± 0.013 %, C_y = 0.954 ± 0.013 %" for k in range(10))
    title = "Besides what looks like " + ", ".join(f"the effect that has the number {k}" for k in range(10))
    names = [f"a_rather_long_name_of_the_recording_{k}" for k in range(6)]
    # within a second the speed changes five times: its names find no room side by side
    time, spin_rate = FIT.time.copy(), np.repeat([366.0, 150.0], 6)
    time[4:9] = np.linspace(10.0, 11.0, 5)
    spin_rate[4:9] = [100.0, 200.0, 300.0, 200.0, 100.0]
    fitted = [replace(FIT, time=time, spin_rate=spin_rate)] + [replace(FIT, name=name) for name in names]
    for parts in (fitted, fitted[:1]):
        unused = replace(VALIDATION, name=names[0])
        check_letters(error_figure([*parts, unused], TABLE, title=title, subtitle=effects))
    for count in (1, 2, 4):
        check_letters(error_figure([FIT], FIT_ONLY, title=title[: 60 * count]))
