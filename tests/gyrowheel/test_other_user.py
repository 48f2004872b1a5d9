"""An ordinary user works from a checkout and with a home folder that they cannot write to."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from gyrowheel_core import cache

from .helpers import DRAG_PLAN

_USER = 65534
#: Another user, who may read what the tests may read, wherever it lies, and write to nothing.
_AS_USER = [
    "setpriv", f"--reuid={_USER}", f"--regid={_USER}", "--clear-groups",
    "--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search",
]  # fmt: skip
_COMMAND = [*_AS_USER, sys.executable, "-c", "from gyrowheel.cli import main; main()"]


def _may_become_another() -> bool:
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        return False
    tried = subprocess.run(
        [*_AS_USER, sys.executable, "-c", "import gyrowheel"], capture_output=True, check=False
    )
    return tried.returncode == 0


@pytest.mark.slow
def test_a_user_who_may_write_nowhere_but_in_a_folder_of_their_own() -> None:
    if not _may_become_another():
        pytest.skip("this test has to run as root, and to be allowed to become another user")
    # not in the folder of pytest, which others may not look into
    with tempfile.TemporaryDirectory(prefix="gyrowheel-test-") as name:
        Path(name).chmod(0o755)
        _work_there(Path(name))


def _work_there(place: Path) -> None:
    home, own, temporary = (place / name for name in ("home", "own", "tmp"))
    home.mkdir(mode=0o555)
    for folder in (own, temporary):
        folder.mkdir(mode=0o700)
    (own / "plan.yaml").write_text(DRAG_PLAN)
    # what was compiled before, so that the test takes seconds; the folder for temporary files holds it
    before, kept = cache.folder(), temporary / f"gyrowheel-cache-{_USER}"
    if before is not None:
        shutil.copytree(before, kept)
    for folder in (own, temporary):
        for entry in (folder, *folder.rglob("*")):
            os.chown(entry, _USER, _USER)
    if kept.exists():
        kept.chmod(0o700)
    unset = {"GYROWHEEL_CACHE", "MPLCONFIGDIR", *(name for name in os.environ if name.startswith("XDG_"))}
    environment = {key: text for key, text in os.environ.items() if key not in unset}
    environment |= {"HOME": str(home), "TMPDIR": str(temporary)}

    def run(*arguments: str) -> None:
        done = subprocess.run(
            [*_COMMAND, *arguments], cwd=own, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "temporary cache" not in done.stderr

    run("simulate", "--plan", "plan.yaml", "-o", "run", "--machine", "3")
    run("model", "new", "--model", "wheel.yaml")
    run("diagnose", "run", "--model", "wheel.yaml", "--picture", "error.png", "--json", "found.json")
    assert json.loads((own / "found.json").read_text())["schema"] == 1
    assert (own / "error.png").stat().st_uid == _USER
    assert not list(home.iterdir())
    assert {path.name for path in temporary.iterdir()} == {kept.name}
