"""Commands of the command line, as a result offers them to be typed next or again."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import Diagnosis


def diagnosing(
    directories: Sequence[Path], model: Path, validate: Sequence[Path] = (), *, averages: bool = False
) -> str:
    """Return the command that diagnoses recordings."""
    unused = "".join(f" --validate {shlex.quote(str(directory))}" for directory in validate)
    return (
        f"gyrowheel diagnose {_quoted(directories)} --model {shlex.quote(str(model))}{unused}"
        f"{' --averages' if averages else ''}"
    )


def adding(what: Sequence[str], fit: Sequence[Path], validate: Sequence[Path], model: Path) -> str:
    """Return the command that adds effects to a model file; `what` has words as they are to be typed."""
    options = "".join(f" --fit {shlex.quote(str(directory))}" for directory in fit)
    options += "".join(f" --validate {shlex.quote(str(directory))}" for directory in validate)
    return f"gyrowheel model add {' '.join(what)} --model {shlex.quote(str(model))}{options}"


def following(
    result: Diagnosis,
    directories: Sequence[Path],
    validate: Sequence[Path],
    model: Path,
    bench: str = "gyrowheel",
    *,
    averages: bool = False,
    machine: str = "",
) -> str | None:
    """Return the command to type after a diagnosis; None if nothing is left to do.

    `machine` has the options for the machine that the recordings are of.
    """
    proof = result.proof
    if proof is not None and proof.proven is False and validate:
        # an effect of the validation recordings alone shows only where they are fitted too
        return diagnosing([*directories, *validate], model, averages=averages)
    if result.verdict == "effect" or result.free_form:
        names = list(result.ties)
        names += [f"--formula {shlex.quote(f'{form.name}: {form.formula}')}" for form in result.free_form]
        return adding(names, directories, validate, model)
    plan = result.next_test.plan if result.next_test is not None else None
    if plan is None or result.verdict == "nothing_missing":
        return None
    new = shlex.quote(str(directories[0].with_name(plan)))
    other = "" if bench == "gyrowheel" or "--bench" in machine else f" --bench {shlex.quote(bench)}"
    other += f" {machine}" if machine else ""
    return (
        f"gyrowheel up --plan {shlex.quote(plan)}{other} --record {new} && "
        f"gyrowheel diagnose {_quoted(directories)} {new} --model {shlex.quote(str(model))}"
        f"{' --averages' if averages else ''}"
    )


def _quoted(paths: Sequence[Path]) -> str:
    return " ".join(shlex.quote(str(path)) for path in paths)
