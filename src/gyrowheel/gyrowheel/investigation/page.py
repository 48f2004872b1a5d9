"""Investigation: how it ended, a table of its steps, and the last diagnosis."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.panel import Panel
from rich.text import Text

from gyrowheel.diagnosis.page import error_section, findings
from gyrowheel.show.layout import words_table
from gyrowheel_core.quantities import listed, seconds

if TYPE_CHECKING:
    from gyrowheel.investigation.procedure import Course, Step
    from gyrowheel_analysis.diagnosis.result import Diagnosis


def investigation_page(done: Course) -> Iterator[RenderableType]:
    """Yield how it ended, the steps, the findings and the errors."""
    colour = "green" if done.settled else "yellow"
    yield Panel(Text(end_sentence(done), style="bold"), border_style=colour, expand=False)
    table = words_table("plan", "why", "verdict", "learned")
    for step in done.steps:
        verdict = step.diagnosis.verdict.replace("_", " ")
        table.add_row(" and ".join(step.plans), step.why, verdict, Text("\n".join(step.learned)))
    yield table
    if done.steps:
        yield from findings(done.steps[-1].diagnosis)
        yield from error_section(done.steps[-1].diagnosis)


def end_sentence(done: Course) -> str:
    """Return how an investigation ended."""
    took = seconds(60.0 * done.minutes)
    state = "Settled" if done.settled else "Not settled"
    left = seconds(60.0 * max(done.budget - done.minutes, 0.0))
    return f"{state} after {took} of bench time, {left} left: {done.reason or 'interrupted'}."


def verdict_line(step: Step) -> str:
    """Return the verdict of a step, the previous one if it differs, and the bench time left."""
    now, before = (text.replace("_", " ") for text in (step.diagnosis.verdict, step.before or ""))
    change = now if not before else f"still {now}" if before == now else f"{before} → {now}"
    left = f"; {seconds(60.0 * step.left)} of bench time left" if step.minutes or step.left else ""
    return f"verdict: {change}{left}"


def unseen_sentence(found: Diagnosis) -> str:
    """Return which effects of usual size stayed below their detection limits; empty if none, or no test shows them."""
    if found.next_test is None:
        return ""
    hidden = dict.fromkeys(limit.effect for limit in found.limits if not limit.visible)
    if not hidden:
        return ""
    return f"At a usual size these recordings would not have shown {listed(list(hidden), 'or')}. To look for more:"
