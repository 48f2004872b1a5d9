"""Compiled code from the cache: what it is made from decides, whatever lies in the folder."""

import contextlib
import os
import random
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from gyrowheel_core.locks import changing

_RUN = """
    import hashlib
    from gyrowheel_sim.jit import compile_source
    print("compiling", flush=True)
    values, hits = [], []
    for name in ("sin", "cos"):
        lines = ["@njit(cache=True)", "def own(x: float) -> float:", f"    return math.{name}(x) * 3.0"]
        own = compile_source("\\n".join(lines), f"a kernel with {name}").own
        values.append(own(0.5).hex())
        hits += own.stats.cache_hits.values()
    print(hashlib.sha256(" ".join(values).encode()).hexdigest(), sum(hits))
"""


def _started(cache: Path) -> subprocess.Popen[str]:
    """Return a process that is about to compile two functions."""
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(_RUN)],
        env={**os.environ, "GYROWHEEL_CACHE": str(cache)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "compiling\n"
    return process


def _result(process: subprocess.Popen[str]) -> tuple[str, int]:
    """Return a digest of results of compiled code, and how often it came from the cache."""
    printed, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    digest, hits = printed.split()
    return digest, int(hits)


def _run(cache: Path) -> tuple[str, int]:
    return _result(_started(cache))


@pytest.mark.slow
@pytest.mark.parametrize("rounds", [1, pytest.param(4, marks=pytest.mark.study)])
def test_damaged_code_is_compiled_again(rounds: int, tmp_path: Path) -> None:
    """Machine code comes from the cache once it is there; damaged, exchanged or missing, it is compiled again."""
    folder = tmp_path / "cache"
    fresh, hits = _run(folder)
    assert hits == 0
    assert _run(folder) == (fresh, 2)
    entries = sorted(place for place in folder.iterdir() if place.name.startswith("code_"))
    whole = [place.read_bytes() for place in entries]
    draw = random.Random(3)
    for round_ in range(rounds):
        for at, (place, content) in enumerate(zip(entries, whole, strict=True)):
            damaged = bytearray(content)
            kind = (2 * round_ + at) % 4
            if kind == 0:
                damaged[draw.randrange(len(damaged))] ^= 1 << draw.randrange(8)
            elif kind == 1:
                del damaged[draw.randrange(len(damaged)) :]
            elif kind == 2:
                damaged = bytearray(whole[0] if content != whole[0] else whole[-1])
            else:
                damaged = bytearray(b"cos\nsystem\n(S'exit 1'\ntR.")
            place.write_bytes(damaged)
        before = [place.read_bytes() for place in entries]
        assert _run(folder) == (fresh, 0), round_
        # what was damaged was written again, too
        assert all(place.read_bytes() != wrong for place, wrong in zip(entries, before, strict=True)), round_
    assert _run(folder) == (fresh, 2)


@pytest.mark.slow
def test_code_that_another_process_compiles_is_awaited(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    fresh, _ = _run(folder)
    entries = {place: place.read_bytes() for place in folder.iterdir() if place.name.startswith("code_")}
    with contextlib.ExitStack() as compiling:
        for place in entries:
            compiling.enter_context(changing(place))
            place.unlink()
        process = _started(folder)
        time.sleep(1.0)  # it looks for the code, which is not there
        for place, content in entries.items():
            place.write_bytes(content)
            place.chmod(0o600)
    assert _result(process) == (fresh, 2)
    assert {place.name for place in folder.iterdir()} == {place.name for place in entries}
