"""Recordings as charts of a page: zoom, and the values at the cursor, by a script within the page."""

from __future__ import annotations

import base64
import hashlib
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from gyrowheel.recordings.picture import envelope
from gyrowheel.show.html import template_text
from gyrowheel.show.panels import PANELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from gyrowheel_recording.bags import Recording

#: The script of the charts. A page with it allows this one script, by its hash, and no other.
SCRIPT: Final = template_text("gyrowheel.report", "chart.js") or ""
#: What a report may do: show itself, and run that script. It asks for nothing from anywhere.
POLICY: Final = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    f"script-src 'sha256-{base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()}'"
)


def chart(recording: Recording) -> dict[str, Any]:
    """Return the signals of a recording for the script: every sample, or smallest and largest of every stretch.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    dict
        ``time`` [s] and, panel by panel, the lines in their units, as float32 in base64; ``pairs`` says whether two
        points in a row are the extremes of one stretch.
    """
    panels: list[dict[str, Any]] = []
    times: NDArray[Any] = recording.time
    for title, unit, fields in PANELS:
        lines = []
        for name, label in fields.items():
            times, values = envelope(recording.time, recording.measurement[name] / unit)
            if np.isfinite(values).any():
                lines.append({"label": label if len(fields) > 1 else "", "values": _base64(values)})
        panels.append({"title": title, "lines": lines})
    return {"time": _base64(times), "pairs": len(times) < len(recording.time), "panels": panels}


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.asarray(values, "<f4").tobytes()).decode("ascii")
