"""The diagnosis: verdict, findings with evidence, errors, detection limits, and the command to type next."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.text import Text

from gyrowheel.comparison.page import coverage, failures, readings
from gyrowheel.show.error_table import error_table
from gyrowheel.show.formulas import is_pure, pretty
from gyrowheel.show.layout import Unbroken, command, heading, indented, sentences, words_table
from gyrowheel.show.sentences.correction import map_sentences
from gyrowheel.show.sentences.diagnosis import (
    evidence,
    form_sentence,
    physics,
    place_text,
    purpose,
    simple_sentence,
    tie_sentence,
    title,
    verdict_sentence,
)
from gyrowheel.show.sentences.findings import instrument_sentence, tie_of_event
from gyrowheel.show.sentences.proof import left_sentences, proof_line
from gyrowheel.show.sentences.setup import cure, map_lines, problem
from gyrowheel_core.quantities import quantity, span, with_error

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.estimates import DetectionLimit
    from gyrowheel_analysis.diagnosis.findings import EffectFinding, FreeForm, InstrumentFinding
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_recording.mislabelled import WrongSetup

_COLOURS = {
    "nothing_missing": "green",
    "effect": "yellow",
    "ambiguous": "yellow",
    "unknown": "red",
    "insufficient_data": "magenta",
}
_SETTLED = ("nothing_missing", "effect")
_NEVER = 10.0  # times the largest usual size, beyond any real bench
_MOVED = 1.0  # stated uncertainties


def diagnosis_page(result: Diagnosis) -> Iterator[RenderableType]:
    """Yield a diagnosis, part by part."""
    if result.setup:
        yield from setup_page(result.setup)
        return
    if result.misstated:
        yield Panel(Text(verdict_sentence(result), style="bold"), border_style="red", expand=False)
        return
    if result.verdict != "nothing_missing":
        yield from failures(result.where)
    yield Text()
    yield from findings(result)
    yield from error_section(result)
    if not result.coverage.complete:
        yield from coverage(result.coverage)
    yield from readings(result)
    yield from _moved(result.nuisance)
    yield from detection_limits(result.limits)


def look_line(found: Diagnosis, seconds: float, state: str) -> Text:
    """Return the diagnosis of a recording in progress, `seconds` long so far, in a line."""
    style = "bold green" if state == "settled" else ""
    place = f"{seconds:7.1f} s  {found.windows:4d} windows  "
    return Text.assemble(place, (f"{state:<7}  ", style), verdict_sentence(found))


def setup_page(found: Sequence[WrongSetup]) -> Iterator[RenderableType]:
    """Yield the problems of each recording and its cure."""
    for place in dict.fromkeys(item.recording for item in found):
        own = [item for item in found if item.recording == place]
        yield Text()
        yield Unbroken(place, style="bold")
        yield from sentences([problem(item) for item in own])
        mended = all(item.cure for item in own)
        yield heading("Cure")
        yield command(cure(own)) if mended else indented(Text(f"{cure(own)}."))
        lines = [line for item in own for line in map_lines(item)]
        if mended and lines:
            yield indented(Text(f"or, where it was imported, in the map: {'; '.join(lines)}", style="dim"))


def error_section(result: Diagnosis) -> Iterator[RenderableType]:
    """Yield the error without and with the findings; nothing without an error table."""
    if result.error is not None:
        yield heading(
            "Error before and after"
            if result.effects or result.instruments or result.free_form or result.map
            else "Error"
        )
        yield indented(error_table(result.error))


def findings(result: Diagnosis) -> Iterator[RenderableType]:
    """Yield the verdict and its evidence."""
    colour = _COLOURS.get(result.verdict, "")
    verdict = Text(verdict_sentence(result), style="bold")
    yield Panel(Group(verdict, proof_line(result.proof, result.error)), border_style=colour, expand=False)
    if left := left_sentences(result.proof, result.rejected, ended=result.ended):
        yield heading("What is left")
        yield from sentences(left)
    if told := [text for text in map(tie_of_event, result.events) if text]:
        yield heading("What happened")
        yield from sentences(told)
    for finding in result.effects:
        yield from _finding(finding)
    yield from _instruments(result.instruments)
    for form in result.free_form:
        yield from _free_form(form)
    if result.map is not None:
        yield Text.assemble((f"\n{result.map.effect.name}", "bold cyan"), "  map of the missing torque")
        yield from sentences(map_sentences(result.map))
    if result.next_test is not None:
        test = result.next_test
        yield heading("Test that would show more" if result.verdict in _SETTLED else "Test that settles it")
        about = f"{test.minutes:.1f} min, expected Δχ² {test.expected_separation:.0f}"
        yield from sentences([f"plan {test.plan} ({about}): {purpose(test)}"])


def detection_limits(limits: Sequence[DetectionLimit]) -> Iterator[RenderableType]:
    """Yield effects that would not have been visible, or only if large."""
    never = [limit for limit in limits if not limit.value <= _NEVER * limit.usual[1]]
    hidden = [limit for limit in limits if not limit.visible and limit not in never]
    partly = [limit for limit in limits if limit.visible and limit.value > limit.usual[0]]
    seen = len(limits) - len(never) - len(hidden) - len(partly)
    if not limits:
        return
    yield heading("Detection limits: what these recordings could not show")
    table = words_table("effect", "visible from", "usual size", "", whole=(0, 1, 2, 3))
    for group, remark in ((hidden, "not visible"), (partly, "only if large")):
        for limit in group:
            table.add_row(
                f"{limit.effect} {limit.coefficient}",
                quantity(limit.value, limit.unit, digits=2),
                span(*limit.usual, limit.unit),
                remark,
            )
    if hidden or partly:
        yield indented(table)
    if never:
        names = ", ".join(dict.fromkeys(limit.effect for limit in never))
        yield indented(Text(f"Not visible at any realistic size: {names}."))
    rest = "All other known effects" if never or hidden or partly else "All known effects"
    if seen:
        yield indented(Text(f"{rest} would show at any usual size.", style="dim"))


def _finding(finding: EffectFinding) -> Iterator[RenderableType]:
    yield Text.assemble(("\n" + finding.name, "bold cyan"), f"  {title(finding)}")
    body = words_table("", "")
    for name, estimate in finding.coefficients.items():
        pure = is_pure(finding.name, name, estimate)
        shown = with_error(estimate.value, estimate.standard_error, estimate.unit, pure=pure)
        if finding.in_model is not None:
            of_model = finding.in_model[name]
            shown += f"  in the model {with_error(of_model.value, of_model.standard_error, of_model.unit, pure=pure)}"
        body.add_row(name, shown)
    body.add_row("law", pretty(finding.formula))
    yield indented(body)
    yield from sentences([physics(finding), *evidence(finding)])
    for tie in finding.ties:
        yield from sentences([tie_sentence(tie)])


def _instruments(found: Sequence[InstrumentFinding]) -> Iterator[RenderableType]:
    for name, own in itertools.groupby(found, lambda f: f.name):
        items = list(own)
        yield Text.assemble((f"\n{name}", "bold cyan"), f"  {items[0].title}")
        body = words_table("", "")
        for item in items:
            shown = with_error(item.value, item.standard_error, item.unit)
            stated = quantity(item.stated, item.unit) if item.stated else "0"
            body.add_row(
                f"{item.channel} {item.quantity.removeprefix('encoder_')}", f"{shown}, stated {stated}"
            )
        yield indented(body)
        yield from sentences(
            [
                items[0].sentence,
                *(instrument_sentence(item) for item in items),
                f"without it χ² is {items[0].delta_chi2:.0f} worse, all else fitted again",
            ]
        )
        for tie in items[0].ties:
            yield from sentences([tie_sentence(tie)])


def _free_form(form: FreeForm) -> Iterator[RenderableType]:
    yield Text.assemble((f"\n{form.name or 'proposed form'}", "bold cyan"), "  proposed form")
    body = words_table("", "")
    for name, estimate in form.coefficients.items():
        shown = with_error(estimate.value, estimate.standard_error, estimate.unit, pure=True)
        if name in form.places:
            shown = f"{place_text(form, name)} ({shown} of the reference)"
        body.add_row(name, shown)
    coefficients = tuple(f"{name} " for name in form.coefficients)
    laws = [part for part in form.formula.split("; ") if not part.startswith(coefficients)]
    body.add_row("law", pretty("; ".join(laws)))
    body.add_row("Δχ²", f"{form.delta_chi2:.0f} without it")
    yield indented(body)
    yield from sentences(filter(None, [form_sentence(form), simple_sentence(form)]))
    if form.simple:
        yield command(f"--formula {shlex.quote(f'{form.name}: {form.simple}')}")
    for tie in form.ties:
        yield from sentences([tie_sentence(tie)])
        if tie.form is not None:
            yield command(f"--formula {shlex.quote(f'{tie.name}: {tie.form.formula}')}")


def _moved(nuisance: Mapping[str, Any]) -> Iterator[RenderableType]:
    moved = {
        name: n
        for name, n in nuisance.items()
        if n.prior_uncertainty > 0.0 and abs(n.value - n.prior_value) > _MOVED * n.prior_uncertainty
    }
    if not moved:
        return
    yield heading("Bench parameters that moved by more than their stated uncertainty")
    table = words_table("parameter", "fitted", "stated", whole=(0, 1, 2))
    for name, n in moved.items():
        table.add_row(
            name,
            with_error(n.value, n.standard_error, n.unit, pure=True),
            with_error(n.prior_value, n.prior_uncertainty, n.unit, pure=True),
        )
    yield indented(table)


def coefficients_line(finding: EffectFinding) -> str:
    """Return the coefficients of a finding in one line."""
    return ", ".join(
        f"{name} = {with_error(e.value, e.standard_error, e.unit, pure=is_pure(finding.name, name, e))}"
        for name, e in finding.coefficients.items()
    )


def diagnosing(
    directories: Sequence[Path], model: Path, validate: Sequence[Path] = (), *, averages: bool = False
) -> str:
    """Return the command that diagnoses recordings."""
    words = [*_words(directories), "--model", str(model), *_words(validate, "--validate")]
    return shlex.join(["gyrowheel", "diagnose", *words, *(["--averages"] if averages else [])])


def adding(what: Sequence[str], fit: Sequence[Path], validate: Sequence[Path], model: Path) -> str:
    """Return the command that adds effects to a model file; `what` has words as they are to be typed."""
    options = ["--model", str(model), *_words(fit, "--fit"), *_words(validate, "--validate")]
    return f"gyrowheel model add {' '.join(what)} {shlex.join(options)}"


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
    if proof is not None and proof.proven is False and validate and result.map is None:
        # an effect of the validation recordings alone shows only where they are fitted too
        return diagnosing([*directories, *validate], model, averages=averages)
    if result.map is not None and not result.free_form:
        return adding(["--map"], directories, validate, model)
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
    diagnosed = diagnosing([*directories, directories[0].with_name(plan)], model, averages=averages)
    return f"gyrowheel up --plan {shlex.quote(plan)}{other} --record {new} && {diagnosed}"


def _words(paths: Sequence[Path], option: str = "") -> list[str]:
    return [word for path in paths for word in (option, str(path)) if word]
