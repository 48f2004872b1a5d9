"""The table of docs/licences.md: the licence of every package that requirements.lock installs.

The licence is that of the package metadata: an SPDX expression, a classifier, a name, the ``package.xml`` of a ROS
package, or the head of its licence file; bundled parts of other projects are listed here. ``make docs`` writes the
page; a licence that is not known to be compatible with Apache-2.0 is an error.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Final

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from gyrowheel_core.errors import InputError

ROOT: Final = Path(__file__).resolve().parent.parent
LOCK: Final = ROOT / "requirements.lock"
#: Licences under which a package may be used beside code under Apache-2.0, as SPDX names them.
COMPATIBLE: Final = frozenset(
    {
        "0BSD",
        "Apache-2.0",
        "Apache-2.0 WITH LLVM-exception",
        "BSD",
        "BSD-2-Clause",
        "BSD-3-Clause",
        "CC0-1.0",
        "ISC",
        "MIT",
        "MIT-CMU",
        "MPL-2.0",
        "PSF-2.0",
        "Public-Domain",
        "Zlib",
        "any-OSI",
    }
)
#: Other spellings of SPDX names. BSD without a number stays, because the variant is not stated.
_WORDS: Final = {
    "Apache 2.0": "Apache-2.0",
    "Apache License 2.0": "Apache-2.0",
    "Apache License, Version 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD",
    "GNU General Public License (GPL)": "GPL",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Public Domain": "Public-Domain",
    "Python Software Foundation License": "PSF-2.0",
    "zlib License": "Zlib",
}
#: Statements that do not apply to the installed files, with the reason.
_SET_ASIDE: Final = {
    ("docutils", "GPL"): "the GPL applies to a file for Emacs that is not in the wheel",
    ("pytest-timeout", "DFSG approved"): "not a licence",
}
#: Packages under stricter licences than ours, and why they are listed: no installation needs them.
_OPTIONAL: Final = {
    "asammdf": "reads MDF files if the extra `mdf` is installed; in this list for the tests",
    "iminuit": "checks the estimator in the tests; in this list for them alone",
    "nptdms": "reads TDMS files if the extra `tdms` is installed; in this list for the tests",
}
#: Bundled parts of other projects whose licence the package does not state: name and licence.
_WITHIN: Final = {"axe-playwright-python": ("axe-core", "MPL-2.0")}
#: First lines of licence files, where a package states its licence in no other way.
_HEADS: Final = {"Apache License": "Apache-2.0", "MIT License": "MIT", "2-Clause BSD": "BSD-2-Clause"}
_LESSER: Final = frozenset({"LGPL-2.1-or-later", "LGPL-3.0-only", "LGPL-3.0-or-later"})
_HEAD: Final = """\
# Licences

<!-- Made by `make docs` from requirements.lock and what the packages state; do not edit. -->

gyrowheel is under the [Apache License 2.0](../LICENSE). `make` installs the following packages from
`requirements.lock`, with version and file hashes. They are not part of this repository. The licences are those that the
packages state; all are compatible with Apache-2.0, and none affects your recordings, models or results. Packages under
the LGPL are not installed by default. BSD without a number means that the package does not state the variant.
"""


def pins(lock: Path = LOCK) -> dict[str, str]:
    """Return the version of every package of the lock file."""
    return dict(re.findall(r"^([a-z0-9.-]+)==(\S+)", lock.read_text(encoding="utf-8"), re.MULTILINE))


def licence(name: str) -> tuple[str, ...]:
    """Return the licences of an installed package; all of them apply.

    Raises
    ------
    InputError
        If the package is not installed, or states no licence, or one that is not among `COMPATIBLE`.
    """
    stated = [_WORDS.get(word, word) for word in _stated(_installed(name))]
    if name in _WITHIN:
        stated.append(_WITHIN[name][1])
    found = tuple(dict.fromkeys(word for word in stated if (name, word) not in _SET_ASIDE))
    for word in found:
        if word in _LESSER and name in _OPTIONAL and name not in running():
            continue
        # of a choice, one is enough
        if not any(part.strip("() ") in COMPATIBLE for part in word.split(" OR ")):
            raise InputError(f"{name}: licence {word!r} is not known to go with Apache-2.0")
    if not found:
        raise InputError(f"{name}: states no licence")
    return found


def _installed(name: str) -> Distribution:
    try:
        return distribution(name)
    except PackageNotFoundError:
        raise InputError(f"{name}: is not installed; `make` installs it") from None


def _stated(package: Distribution) -> list[str]:
    about = package.metadata
    if "License-Expression" in about:
        return about["License-Expression"].split(" AND ")
    classifiers = [str(text) for text in about.get_all("Classifier") or ()]
    if words := [text.rpartition(" :: ")[2] for text in classifiers if text.startswith("License :: ")]:
        return words
    if "License" in about and about["License"].strip():
        return [about["License"].strip()]
    own = str(about["Name"]).removeprefix("ros-").removeprefix("jazzy-").replace("-", "_")
    manifest = Path(sys.prefix, "share", own, "package.xml")
    if manifest.is_file():
        return re.findall(r"<license[^>]*>\s*([^<]*?)\s*</license>", manifest.read_text(encoding="utf-8"))
    files = [file for file in package.files or () if file.stem == "LICENSE" and ".dist-info" in str(file)]
    heads = [" ".join(file.read_text(encoding="utf-8").split("\n", 5)[:5]) for file in files]
    return [word for head in heads for words, word in _HEADS.items() if words in head]


@cache
def running() -> frozenset[str]:
    """Return the packages that an installation needs to run, of those that the lock file installs."""
    names, waiting = set(), []
    for path in (ROOT / "src").glob("*/pyproject.toml"):
        waiting += tomllib.loads(path.read_text(encoding="utf-8"))["project"]["dependencies"]
    known = pins()
    while waiting:
        needed = Requirement(waiting.pop())
        name = canonicalize_name(needed.name)
        if (
            name in names
            or name not in known
            or not (needed.marker is None or needed.marker.evaluate({"extra": ""}))
        ):
            continue
        names.add(name)
        waiting += _installed(name).requires or ()
    return frozenset(names)


def _rows() -> Iterator[str]:
    for name, version in sorted(pins().items()):
        use = "runs" if name in running() else "builds, checks"
        yield f"| {name} | {version} | {', '.join(licence(name))} | {use} |"


def page() -> str:
    """Return the page of the licences.

    Raises
    ------
    InputError
        As `licence` does.
    """
    aside = [f"- {name}: {reason}." for (name, word), reason in _SET_ASIDE.items() if word.isupper()]
    aside += [f"- {name}: {reason}." for name, reason in _OPTIONAL.items()]
    aside += [
        f"- {name}: the {word} is that of {held}, which it contains."
        for name, (held, word) in _WITHIN.items()
    ]
    return "\n".join(
        [_HEAD, *aside, "", "| package | version | licence | for |", "|---|---|---|---|", *_rows(), ""]
    )
