"""Compiled code from the cache: what it is made from decides, whatever lies in the folder."""

import os
import random
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

_RUN = """
    import hashlib
    from gyrowheel_sim.jit import compile_source
    values, hits = [], []
    for name in ("sin", "cos"):
        lines = ["@njit(cache=True)", "def own(x: float) -> float:", f"    return math.{name}(x) * 3.0"]
        own = compile_source("\\n".join(lines), f"a kernel with {name}").own
        values.append(own(0.5).hex())
        hits += own.stats.cache_hits.values()
    print(hashlib.sha256(" ".join(values).encode()).hexdigest(), sum(hits))
"""


def _run(cache: Path) -> tuple[str, int]:
    """Return a digest of results of compiled code, and how often it came from the cache."""
    environment = {**os.environ, "GYROWHEEL_CACHE": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(_RUN)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    digest, hits = done.stdout.split()
    return digest, int(hits)


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
