"""An ordinary user works from a checkout and with a home folder that they cannot write to."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from gyrowheel_core import cache

from ..domains import next_domain
from .helpers import DRAG_PLAN

_USER = 65534
#: Another user, who may read what the tests may read, wherever it lies, and write to nothing.
_AS_USER = [
    "setpriv", f"--reuid={_USER}", f"--regid={_USER}", "--clear-groups",
    "--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search",
]  # fmt: skip
_COMMAND = [*_AS_USER, sys.executable, "-c", "from gyrowheel.cli.app import main; main()"]


def _may_become_another() -> bool:
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        return False
    tried = subprocess.run(
        [*_AS_USER, sys.executable, "-c", "import gyrowheel"], capture_output=True, check=False
    )
    return tried.returncode == 0


class _Place:
    """Folders of another user: a home that they cannot write to, one of their own and one for temporary files."""

    def __init__(self, place: Path) -> None:
        place.chmod(0o755)
        self.home, self.own, self._temporary = (place / name for name in ("home", "own", "tmp"))
        self.home.mkdir(mode=0o555)
        for folder in (self.own, self._temporary):
            folder.mkdir(mode=0o700)
        # what was compiled before, so that the test takes seconds; the folder for temporary files holds it
        before, self._kept = cache.folder(), self._temporary / f"gyrowheel-cache-{_USER}"
        if before is not None:
            self._kept.mkdir()
            for entry in before.glob("code_*"):
                with contextlib.suppress(FileNotFoundError):  # another process may remove old entries
                    shutil.copy(entry, self._kept)
        for folder in (self.own, self._temporary):
            for entry in (folder, *folder.rglob("*")):
                os.chown(entry, _USER, _USER)
        if self._kept.exists():
            self._kept.chmod(0o700)

    def run(self, *arguments: str, **more: str) -> str:
        """Run a command, with more variables in its environment, and return what it printed."""
        unset = {"GYROWHEEL_CACHE", "MPLCONFIGDIR", *(name for name in os.environ if name.startswith("XDG_"))}
        environment = {key: text for key, text in os.environ.items() if key not in unset}
        environment |= {"HOME": str(self.home), "TMPDIR": str(self._temporary), **more}
        done = subprocess.run(
            [*_COMMAND, *arguments],
            cwd=self.own,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert "temporary cache" not in done.stderr
        return done.stdout

    def check(self) -> None:
        """Check that nothing lies beside the results."""
        assert not list(self.home.iterdir())
        assert {path.name for path in self._temporary.iterdir()} == {self._kept.name}


@pytest.fixture
def place() -> Iterator[_Place]:
    """Give the folders of another user."""
    if not _may_become_another():
        pytest.skip("this test has to run as root, and to be allowed to become another user")
    # not in the folder of pytest, which others may not look into
    with tempfile.TemporaryDirectory(prefix="gyrowheel-test-") as name:
        yield _Place(Path(name))


@pytest.mark.study  # of installations that seldom differ
@pytest.mark.slow
def test_verbs_work_for_a_user_with_one_writable_folder(place: _Place) -> None:
    (place.own / "plan.yaml").write_text(DRAG_PLAN)
    place.run("simulate", "--plan", "plan.yaml", "-o", "run", "--machine", "3")
    place.run("model", "new", "--model", "wheel.yaml")
    place.run("diagnose", "run", "--model", "wheel.yaml", "--picture", "error.png", "--json", "found.json")
    assert json.loads((place.own / "found.json").read_text())["schema"] == 1
    assert (place.own / "error.png").stat().st_uid == _USER
    place.check()


@pytest.mark.study
@pytest.mark.graph
def test_the_demonstration_works_for_a_user_with_one_writable_folder(place: _Place) -> None:
    """With all its nodes, each a process of that user."""
    said = place.run("demo", "--seed", "5", "-o", "results", "--json", "-", ROS_DOMAIN_ID=str(next_domain()))
    outcome = json.loads(said)
    assert outcome["right"]
    paths = [Path(path) for path in outcome["paths"].values()]
    assert {(place.own / path).stat().st_uid for path in paths} == {_USER}
    place.check()
