"""Pictures, all in the one style of `style`: each function returns a figure; `figure.write_figure` writes it."""

import os
from pathlib import Path

from gyrowheel_core import cache

_VARIABLE = "MPLCONFIGDIR"


def _keep_settings() -> None:
    """Have matplotlib use our cache where it may not write to the user's settings: else it warns and is slow."""
    usual = Path(os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")) / "matplotlib"
    there = next((folder for folder in (usual, *usual.parents) if folder.exists()), Path("/"))
    place = cache.folder()
    if _VARIABLE not in os.environ and place is not None and not os.access(there, os.W_OK):
        os.environ[_VARIABLE] = str(place / "matplotlib")


_keep_settings()
