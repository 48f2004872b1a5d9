"""Pictures of a report: vector graphics with drawn letters, and the signals as charts of a script within the page."""

from __future__ import annotations

import base64
import hashlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from gyrowheel.recordings.picture import envelope
from gyrowheel.show.figure import png_bytes
from gyrowheel.show.html import template_text
from gyrowheel.show.panels import PANELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from gyrowheel_recording.bags import Recording

#: Script of the charts. The page allows this script only, by its hash.
SCRIPT: Final = template_text("gyrowheel.report", "chart.js") or ""
#: Policy of a report: its own content and that script only; no requests.
POLICY: Final = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
    f"script-src 'sha256-{base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()}'"
)
_LARGEST = 600_000  # largest vector picture [bytes]; a larger one is stored as PNG


@dataclass(frozen=True)
class Picture:
    """A picture in a page.

    Attributes
    ----------
    source : str
        Its bytes as a data URL.
    title : str
        Its alternative text.
    """

    source: str
    title: str


def picture(draw: Callable[[], Figure], title: str) -> Picture:
    """Return the drawing of a function as a picture of a page."""
    import matplotlib as mpl

    figure = draw()
    stream = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "path", "svg.hashsalt": "gyrowheel"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    kind, content = "svg+xml", stream.getvalue()
    if len(content) > _LARGEST:
        kind, content = "png", png_bytes(figure)
    return Picture(f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}", title)


def chart(recording: Recording) -> dict[str, Any]:
    """Return the signals of a recording for the script: every sample, or minimum and maximum of each interval.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    dict
        ``time`` [s] and, panel by panel, the lines in their units, as float32 in base64; ``pairs`` tells whether two
        successive points are the extremes of one interval.
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
