"""OpenFOAM programs: their location, version, and execution."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

from gyrowheel_core.errors import InputError
from gyrowheel_core.processes import die_with_parent

#: Where distributions put OpenFOAM's own files; the programs need to know it, and nothing else of its shell setup.
_HOMES = ("/usr/share/openfoam", "/usr/lib/openfoam")
INSTALL_HINT = (
    "OpenFOAM is not installed (no simpleFoam, blockMesh on the PATH): install it with 'apt-get install openfoam' "
    "(Debian, Ubuntu); all but 'cfd mesh', 'cfd run' and 'cfd sweep' works without it, on the shipped table"
)


#: Receives the present iteration of a program.
Step = Callable[[int], None]


class SolverError(InputError):
    """A program of OpenFOAM failed; the text names the program, the reason that it gave and its log."""


def available() -> bool:
    """Return whether OpenFOAM is installed."""
    return all(shutil.which(name) for name in ("simpleFoam", "blockMesh", "checkMesh"))


def require() -> None:
    """Refuse to continue without OpenFOAM; the error says how to install it."""
    if not available():
        raise InputError(INSTALL_HINT)


def environment() -> dict[str, str]:
    """Return the environment for programs of OpenFOAM.

    The distribution's ``bashrc`` is not sourced: it sets what the packaged programs do not need and fails under
    ``set -u``. ``WM_PROJECT_DIR`` alone is needed: the programs find their dictionaries below it.
    """
    result = dict(os.environ)
    if "WM_PROJECT_DIR" not in result:
        found = next((home for home in _HOMES if Path(home, "etc", "controlDict").is_file()), None)
        if found is not None:
            result["WM_PROJECT_DIR"] = found
    # one case, one core: the parallel libraries that it links must not start threads of their own
    return result | {"OMP_NUM_THREADS": "1", "FOAM_SIGFPE": "true"}


def version_in(text: str) -> str | None:
    """Return the version and patch that a log names, for example ``1912 (patch=200626)``, or None."""
    found = re.search(r"^Build\s*:\s*(?:OPENFOAM=)?(.+?)\s*$", text, re.MULTILINE)
    if found is None:
        return None
    number, _, patch = found.group(1).partition(" ")
    return f"{number} ({patch.strip()})" if patch else number


def run(command: list[str], folder: Path, log: Path, *, step: Step | None = None) -> str:
    """Run one program in a case folder, its output into a log, and return the log.

    The program is a process group of its own and ends with this one: on an interrupt, an error, or a kill by
    SIGTERM that was turned into an exception. While it runs, `step` is told its last iteration now and then.

    Raises
    ------
    SolverError
        If the program ends with an error.
    """
    with log.open("w", encoding="utf-8") as target:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=target,
            stderr=subprocess.STDOUT,
            env=environment() | {"PWD": str(folder.resolve())},
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
        try:
            code = _wait(process, log, step)
        except BaseException:
            _end(process)
            raise
    text = log.read_text(encoding="utf-8", errors="replace")
    if code != 0:
        raise SolverError(f"{command[0]} failed: {reason(text, code)}; log: {log}")
    return text


def _wait(process: subprocess.Popen[bytes], log: Path, step: Step | None) -> int:
    while step is not None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(timeout=0.5)
        with log.open("rb") as source:
            source.seek(max(0, log.stat().st_size - 4096))
            times = re.findall(rb"^Time = (\d+)\s*$", source.read(), re.MULTILINE)
        if times:
            step(int(times[-1]))
    return process.wait()


def reason(text: str, code: int) -> str:
    """Return the reason of a failure, in one line, from the log of the program."""
    error = re.search(r"--> FOAM FATAL (?:IO )?ERROR:?\s*(.+?)(?:\n\s*\n|\n\s*From |\Z)", text, re.DOTALL)
    if error is not None:
        return " ".join(error.group(1).split())
    if "sigFpe" in text or code in (-signal.SIGFPE, 128 + signal.SIGFPE):
        return "the solution diverged (floating-point exception)"
    if code < 0:
        return f"ended by signal {-code} ({signal.strsignal(-code)})"
    last = text.strip().splitlines()[-1:]
    return " ".join(last[0].split()) if last else f"exit status {code}"


def _end(process: subprocess.Popen[bytes]) -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()
