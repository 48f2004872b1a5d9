"""Benches of one's own: a bench file to begin with, and what a bench can reach."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from gyrowheel_analysis.capability import Reach
from gyrowheel_analysis.capability import reach as reach_of
from gyrowheel_analysis.fitting.preparation import one_thread
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import write_text
from gyrowheel_sim.bench import Bench, bench_text

__all__ = ["Reach", "new_bench", "reach", "reach_json"]


def new_bench(file: str | Path, like: str | Path | Bench = "gyrowheel") -> None:
    """Write a bench file to begin with: a copy of another bench that says what every value is.

    Raises
    ------
    InputError
        If the file is there already or cannot be written, or there is no such bench.
    """
    loaded = like if isinstance(like, Bench) else Bench.load(like)
    if Path(file).exists():
        raise InputError(f"{file}: exists; name a new file")
    write_text(Path(file), bench_text(loaded, Path(file).stem))


@one_thread()
def reach(bench: str | Path | Bench = "gyrowheel") -> Reach:
    """Return what a bench can reach with its coils and its motor."""
    return reach_of(bench if isinstance(bench, Bench) else Bench.load(bench))


def reach_json(found: Reach) -> dict[str, Any]:
    """Return it as a JSON object; SI units."""
    return {"speeds": [asdict(own) for own in found.speeds], "largest_tilt": found.largest_tilt}
