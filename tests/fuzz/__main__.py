"""``python -m tests.fuzz``: try inputs of every kind for some minutes, print what became of them, keep what failed."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from .harness import Failure, Tally, run, smallest
from .kinds import KINDS


def main() -> int:
    """Return 1 if anything failed, 130 if Ctrl-C ended it."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument(
        "kind", nargs="*", help=f"kinds of input; all of them if none is named: {', '.join(KINDS)}"
    )
    parser.add_argument("--minutes", type=float, default=5.0, help="for how long, all kinds together")
    parser.add_argument("--count", type=int, default=0, help="how many of each kind, in place of a time")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of what is drawn at random")
    parser.add_argument(
        "--keep", type=Path, default=Path("fuzz_findings"), help="folder for inputs that failed"
    )
    asked = parser.parse_args()
    if unknown := [name for name in asked.kind if name not in KINDS]:
        parser.error(f"kind: {unknown[0]!r} is not known; allowed: {', '.join(KINDS)}")
    kinds = asked.kind or list(KINDS)
    seconds = 0.0 if asked.count else 60.0 * asked.minutes / len(kinds)
    failures = 0
    print(f"seed {asked.seed}")
    for name in kinds:
        with tempfile.TemporaryDirectory(prefix="gyrowheel-fuzz-") as folder:
            tally = run(KINDS[name], asked.seed, Path(folder), count=asked.count, seconds=seconds)
            report(name, tally)
            for number, failure in enumerate(tally.failures):
                kept(failure, asked.keep / f"{name}_{asked.seed}_{number}")
        failures += tally.outcomes["failed"]
        if tally.interrupted:
            return 130
    return 1 if failures else 0


def report(name: str, tally: Tally) -> None:
    """Print what became of the inputs of one kind."""
    outcomes = ", ".join(f"{count} {what}" for what, count in tally.outcomes.most_common())
    print(
        f"{name:10} {tally.count:6}  longest {tally.longest:.2f} s, memory {tally.largest / 1e9:.2f} GB  {outcomes}",
        flush=True,
    )


def kept(failure: Failure, file: Path) -> None:
    """Write the smallest input with which the same goes wrong, and say where it is."""
    data = smallest(failure)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    shown = f"  {data!r}" if len(data) < 200 else ""
    print(f"  {failure}\n  {len(data)} bytes in {file}{shown}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
