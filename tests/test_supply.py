"""What `make` installs: pinned by version and hash, and under licences that go with ours."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from email.message import Message
from pathlib import Path
from types import SimpleNamespace

import pytest

from gyrowheel_core.errors import InputError
from tools import licences, lock

#: What the package of the messages is built from.
MESSAGES = ("package.xml", "CMakeLists.txt", "pyproject.toml")
_PIN = re.compile(r"[a-z0-9.-]+==\S+( \\\n    --hash=sha256:[0-9a-f]{64})+\n")


def test_every_package_of_the_lock_file_has_hashes_and_they_are_asked_for() -> None:
    text = licences.LOCK.read_text(encoding="utf-8")
    assert text.startswith(lock.HEADER)
    assert _PIN.sub("", text.removeprefix(lock.HEADER)) == ""
    makefile = (licences.ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", "")
    installs = re.findall(r"(?:\$\(PIP\)|uv pip [^;|]*?) install [^;|]*--requirement", makefile)
    assert len(installs) == 2
    assert all("--require-hashes" in line for line in installs)
    # nothing is looked for beside it: an older pip takes the newest release of what is asked for with an extra
    assert all("--no-deps" in line for line in installs)


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Give a checkout of the Makefile alone, with an environment that is complete."""
    done = tmp_path / "é a" / ".venv" / ".done"
    own = done.parent.parent
    (own / "src" / "gyrowheel_msgs").mkdir(parents=True)
    shutil.copy(licences.ROOT / "Makefile", own)
    for name in ("requirements.lock", *(f"src/gyrowheel_msgs/{n}" for n in MESSAGES)):
        (own / name).touch()
    done.mkdir(parents=True)
    for name in ("requirements", "msgs", "packages"):
        (done / name).touch()
    (done / "venv").write_text(f"{own}\n", encoding="utf-8")
    return own


def _make(checkout: Path, *arguments: str, before: Sequence[str] = ()) -> subprocess.CompletedProcess[str]:
    own = {key: text for key, text in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL")}
    command = [*before, "make", *arguments, f"PYTHON={sys.executable}"]
    return subprocess.run(command, cwd=checkout, capture_output=True, text=True, env=own)


def test_a_checkout_that_was_moved_or_half_installed_gets_another_environment(checkout: Path) -> None:
    assert _make(checkout).stdout == 'ready: .venv/bin/gyrowheel ("make demo" shows what it does)\n'
    moved = checkout.rename(checkout.with_name("moved"))
    text = _make(moved, "--dry-run").stdout
    assert "-m venv --clear .venv" in text
    assert "--require-hashes" in text
    moved.rename(checkout)
    assert "venv" not in _make(checkout, "--dry-run").stdout.replace(".venv/bin/gyrowheel", "")
    (checkout / ".venv" / ".done" / "venv").unlink()  # while packages are installed
    assert "-m venv --clear .venv" in _make(checkout, "--dry-run").stdout


def test_a_second_make_does_not_install_at_the_same_time(checkout: Path) -> None:
    (checkout / ".venv" / ".done" / "packages").unlink()
    with (checkout / "Makefile").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        found = _make(checkout)
    assert found.returncode == 2
    assert "another make installs into .venv" in found.stderr


def test_a_checkout_that_the_user_cannot_write_to_is_named_before_anything_is_installed(
    checkout: Path,
) -> None:
    (checkout / ".venv" / ".done" / "packages").unlink()
    (checkout / "Makefile").chmod(0o444)
    # root can write to everything while it has the capabilities for it
    found = _make(
        checkout, before=() if os.geteuid() else ("setpriv", "--bounding-set=-all", "--inh-caps=-all")
    )
    assert found.returncode == 2
    assert "this checkout belongs to another user" in found.stderr


@pytest.mark.slow
def test_the_lock_file_lacks_nothing_that_its_packages_need() -> None:
    checked = subprocess.run([sys.executable, "-m", "pip", "check"], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout


def test_the_lock_file_has_what_the_packages_ask_for() -> None:
    asked = {re.split(r"[<>=\[ ;]", text)[0].lower().replace("_", "-") for text in lock.requirements()}
    assert asked <= set(licences.pins())


def test_the_page_of_the_licences_is_up_to_date() -> None:
    pytest.importorskip("sphinx", reason="the page lists what makes the site as well")
    page = licences.ROOT / "docs" / "licences.md"
    assert page.read_text(encoding="utf-8") == licences.page(), "`make docs` writes it anew"


@pytest.mark.parametrize(
    ("field", "text", "found"),
    [
        ("License-Expression", "MIT AND Zlib", ("MIT", "Zlib")),
        ("License-Expression", "GPL-3.0-only OR MIT", ("GPL-3.0-only OR MIT",)),
        ("License-Expression", "MIT AND GPL-3.0-only", None),
        ("Classifier", "License :: OSI Approved :: BSD License", ("BSD",)),
        ("Classifier", "License :: OSI Approved :: GNU Affero General Public License v3", None),
        ("License", "Apache 2.0", ("Apache-2.0",)),
        ("License", "ask us", None),
        ("Summary", "no licence at all", None),
    ],
)
def test_a_licence_that_does_not_go_with_ours_is_refused(
    field: str, text: str, found: tuple[str, ...] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = Message()
    about["Name"] = "other"
    about[field] = text
    monkeypatch.setattr(licences, "distribution", lambda name: SimpleNamespace(metadata=about, files=()))
    if found is None:
        with pytest.raises(InputError, match=r"^other: (licence .* is not known to go|states no licence)"):
            licences.licence("other")
    else:
        assert licences.licence("other") == found
