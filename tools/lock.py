"""Write requirements.lock: one version, with hashes, of every package for building, running and testing ours.

The requirements are read from their pyproject.toml files. ``make lock`` calls this, in an environment with ``uv``.
"""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOCK = ROOT / "requirements.lock"
HEADER = """\
# Written by `make lock` from the pyproject.toml files, for Python 3.11 on Linux; do not edit.
# Holds all that `make` installs: what the packages need to run, what builds them, what checks them.
# The hashes are those of the files on PyPI; pip refuses any other file, from whatever index or cache it comes.
"""


def requirements() -> list[str]:
    """Return the requirements of the pyproject.toml files, without our packages."""
    wanted: set[str] = set()
    for group in tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"].values():
        wanted.update(group)
    for path in sorted((ROOT / "src").glob("*/pyproject.toml")):
        package = tomllib.loads(path.read_text())
        wanted.update(package["build-system"]["requires"])
        wanted.update(package["project"]["dependencies"])
    return sorted(name for name in wanted if not name.startswith("gyrowheel-"))


def main() -> int:
    """Resolve the requirements to the newest compatible versions; replace the lock file if they exist."""
    options = "--quiet --no-config --no-header --no-annotate --no-emit-index-url --no-emit-find-links --generate-hashes"
    target = "--python-version 3.11 --python-platform x86_64-manylinux_2_28"
    resolved = subprocess.run(
        [sys.executable, "-m", "uv", "pip", "compile", *options.split(), *target.split(), "-"],
        input="\n".join(requirements()),
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if resolved.returncode == 0:
        LOCK.write_text(HEADER + resolved.stdout)
    return resolved.returncode


if __name__ == "__main__":
    raise SystemExit(main())
