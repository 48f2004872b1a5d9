"""Finished cases in the journal of a campaign, from which it goes on."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Sequence
from dataclasses import asdict

from pydantic import TypeAdapter, ValidationError

from gyrowheel.campaigns.cases import Case
from gyrowheel.campaigns.judge import Judged
from gyrowheel_core.journal import Journal


@functools.cache
def _judged() -> TypeAdapter[Judged]:
    return TypeAdapter(Judged)


def note(journal: Journal, case: Judged) -> None:
    """Keep a finished case.

    Raises
    ------
    InputError
        If the disk refuses it.
    """
    journal.finish(f"case-{case.index:04d}", asdict(case))


def earlier(journal: Journal, wanted: Sequence[Case]) -> list[Judged]:
    """Return the cases that were finished before, of those wanted, equal to what was noted."""
    kinds = {case.index: case.kind for case in wanted}
    found: dict[int, Judged] = {}
    for content in journal.finished().values():
        with contextlib.suppress(ValidationError):
            case = _judged().validate_python(content)
            if kinds.get(case.index) == case.kind:
                found[case.index] = case
    return list(found.values())
