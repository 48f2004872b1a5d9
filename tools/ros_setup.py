"""What another ROS 2 environment needs to see the messages and the packages of the bench: ``. .venv/ros/setup.sh``.

The environment of `make` has a ROS of its own, whose libraries must not take the place of those of the other one:
folders with links to what is ours alone are put behind its paths.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

_SETUP = """\
# Written by make. Lets another ROS 2 Jazzy environment see the bench: its messages, its packages, its files.
export AMENT_PREFIX_PATH="${{AMENT_PREFIX_PATH:+$AMENT_PREFIX_PATH:}}{prefix}"
export LD_LIBRARY_PATH="${{LD_LIBRARY_PATH:+$LD_LIBRARY_PATH:}}{place}/lib"
export PYTHONPATH="${{PYTHONPATH:+$PYTHONPATH:}}{place}/python"
"""


def write(prefix: Path, packages: Path) -> Path:
    """Write the script for the environment `prefix`, whose packages are those of the folder `packages`; return it."""
    place = prefix / "ros"
    shutil.rmtree(place, ignore_errors=True)
    for name in ("lib", "python"):
        (place / name).mkdir(parents=True)
    for library in sorted((prefix / "lib").glob("libgyrowheel_msgs__*.so")):
        (place / "lib" / library.name).symlink_to(library)
    (messages,) = sorted((prefix / "lib").glob("python3*/site-packages/gyrowheel_msgs"))
    own = [
        messages,
        *(module for folder in sorted(packages.iterdir()) if (module := folder / folder.name).is_dir()),
    ]
    for module in own:
        (place / "python" / module.name).symlink_to(module)
    script = place / "setup.sh"
    script.write_text(_SETUP.format(prefix=prefix, place=place), encoding="utf-8")
    return script


if __name__ == "__main__":
    root = Path(__file__).resolve().parents[1]
    write(root / ".venv", root / "src")
    sys.exit(0)
