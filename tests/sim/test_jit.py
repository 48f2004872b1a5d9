"""Compiled code from the cache: what it is made from decides, whatever lies in the folder."""

import os
import random
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

_RUN = """
    import hashlib, sys
    import numpy as np
    from gyrowheel_analysis.fitting.variance import DriftCovariance
    middle = np.cumsum(np.full(40, 1.7))
    covariance = DriftCovariance(middle, np.full(40, 1e-8), 2e-4, 20.0)
    white = covariance.whiten(np.sin(middle), 1.0)
    from gyrowheel_sim.jit import compile_source
    lines = ["@njit(cache=True)", "def own(x: float) -> float:", "    return math.sin(x) * 3.0"]
    own = compile_source("\\n".join(lines), "a kernel").own
    value = own(0.5)
    digest = hashlib.sha256(white.tobytes() + np.float64(value).tobytes()).hexdigest()
    print(digest, sum(own.stats.cache_hits.values()))
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
    assert _run(folder) == (fresh, 1)
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
    assert _run(folder) == (fresh, 1)
