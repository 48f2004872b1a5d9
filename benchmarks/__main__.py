"""The command: ``python -m benchmarks [SUBJECT...]`` prints the tables and writes ``bench.json``."""

from __future__ import annotations

import argparse
import importlib
import platform
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks import LONG, SUBJECTS
from benchmarks.results import MeasurementError, Report, shown, to_json
from gyrowheel.cli.console import BAD_INPUT, FINDING, INTERRUPTED, OK, advancing, put_text
from gyrowheel_core.errors import InputError
from gyrowheel_core.files import disk_errors, write_text


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the requested subjects and return the exit code."""
    parser = _parser()
    asked = parser.parse_args(arguments)
    if stray := [name for name in asked.subject if name not in SUBJECTS]:
        parser.error(f"subject: {stray[0]!r} is not known; allowed: {', '.join(SUBJECTS)}")
    file = Path(asked.json)
    reports: list[Report] = []
    try:
        # fail before the measurement, not after some minutes, if the file cannot be written
        with disk_errors(file), tempfile.TemporaryFile(dir=file.absolute().parent):
            pass
        for name in asked.subject or [name for name in SUBJECTS if name not in LONG]:
            module = importlib.import_module(f"benchmarks.{name}")
            with advancing(f"measuring {name}") as advance:
                found = module.measure(advance)
            for report in found:
                put_text(shown(report))
            reports += found
        write_text(file, to_json(reports))
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return BAD_INPUT
    except MeasurementError as error:
        sys.stderr.write(f"error: {name}: {error}\n")
        return FINDING
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return INTERRUPTED
    missed = [figure.name for report in reports for figure in report.figures if figure.holds is False]
    bars = sum(figure.bar is not None for report in reports for figure in report.figures)
    sys.stdout.write(
        f"\n{bars - len(missed)} of {bars} bars hold, on {_machine()}; figures in {asked.json}\n"
    )
    return FINDING if missed and asked.fail else OK


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, SUBJECTS))
    subjects = "\n".join(f"  {name:{width}}  {about}" for name, about in SUBJECTS.items())
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measure speed and accuracy of the bench.",
        epilog=f"subjects:\n{subjects}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "subject",
        nargs="*",
        metavar="SUBJECT",
        help=f"what to measure (default: everything but {', '.join(sorted(LONG))})",
    )
    parser.add_argument(
        "--json", metavar="FILE", default="bench.json", help="file of the figures (%(default)s)"
    )
    parser.add_argument("--fail", action="store_true", help="end with 1 if a bar does not hold")
    return parser


def _machine() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        model = next(
            line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")
        )
    except (OSError, StopIteration):
        model = platform.processor() or platform.machine()
    return f"{model}, Python {platform.python_version()}"


if __name__ == "__main__":
    sys.exit(main())
