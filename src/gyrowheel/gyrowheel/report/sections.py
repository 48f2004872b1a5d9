"""Sections of a report, ready for the template: sentences, rows of tables, strips of the detection limits."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gyrowheel.recordings.page import integrity_text
from gyrowheel.show.error_table import unit_of
from gyrowheel.show.formulas import is_pure, pretty, typeset
from gyrowheel.show.html import Cells, declared, label
from gyrowheel.show.sentences.correction import range_text
from gyrowheel.show.sentences.diagnosis import (
    physics,
    purpose,
    simple_sentence,
    tie_sentence,
    title,
    unproven,
)
from gyrowheel.show.sentences.findings import tie_of_event, untold_sentences
from gyrowheel.show.sentences.setup import cure_of, map_lines, problem
from gyrowheel_analysis.channels import LISTED
from gyrowheel_core.quantities import short
from gyrowheel_core.units import DEG, RPM, Unit, unit_for
from gyrowheel_core.units import pretty as pretty_unit
from gyrowheel_sim.effects.quantities import QUANTITIES
from gyrowheel_sim.effects.torque_map import TorqueMap

if TYPE_CHECKING:
    from gyrowheel.investigation.api import Investigation
    from gyrowheel.models.api import Model
    from gyrowheel.recordings.api import Recording
    from gyrowheel_analysis.diagnosis.estimates import DetectionLimit
    from gyrowheel_analysis.diagnosis.findings import EffectFinding
    from gyrowheel_analysis.diagnosis.result import Diagnosis
    from gyrowheel_analysis.residuals.error_table import ErrorRow
    from gyrowheel_recording.mislabelled import WrongSetup

_PLAIN = Unit("", 1.0)
_MEGABYTE = Unit("MB", 1e6)
_DECADES = 1.0  # to both sides of a detection limit that its strip shows
_MOVED = 1.0  # stated uncertainties
#: Verdicts in words for a reader of page one alone.
VERDICTS = {
    "nothing_missing": "Nothing is missing in the model",
    "effect": "Known effect that the model lacks",
    "ambiguous": "Several explanations, not settled",
    "unknown": "Unknown effect that the model lacks",
    "insufficient_data": "Too few data for a verdict",
}
_UNPROVEN = "Effect that the model may lack, not proven"
#: Colour of a verdict.
MOOD = {
    "nothing_missing": "good",
    "effect": "found",
    "ambiguous": "found",
    "unknown": "bad",
    "insufficient_data": "open",
}


def verdict(found: Diagnosis) -> str:
    """Return a verdict in words."""
    return _UNPROVEN if found.verdict == "effect" and unproven(found) else VERDICTS[found.verdict]


def steps(done: Investigation, cells: Cells) -> list[dict[str, Any]]:
    """Return the steps of an investigation."""
    return [
        {
            "plans": cells.shown(
                f"investigation.steps.{k}.plans", " and ".join(step.plans) or "Recordings at hand", "names"
            ),
            "verdict": step.diagnosis.verdict.replace("_", " "),
            "why": cells.words(f"investigation.steps.{k}.why"),
            "minutes": cells.digits(f"investigation.steps.{k}.minutes", 1) if step.minutes else "",
            "learned": [
                cells.words(f"investigation.steps.{k}.learned.{n}") for n in range(len(step.learned))
            ],
        }
        for k, step in enumerate(done.steps)
    ]


def of_diagnosis(found: Diagnosis, cells: Cells) -> dict[str, Any]:
    """Return the sections of a diagnosis, which report and workbench share; its JSON is ``diagnosis`` of the cells."""
    rows = limits(found, cells)
    return {
        "summary": cells.words("diagnosis.summary"),
        "mood": MOOD[found.verdict],
        "setup": setup(found.setup),
        "findings": findings(found, cells),
        "instruments": instruments(found, cells),
        "forms": forms(found, cells),
        "map": correction_map(found, cells),
        "events": events(found),
        "readings": readings(found, cells),
        "remarks": remarks(found, cells),
        "next_test": next_test(found, cells),
        "regions": regions(cells),
        "limits": {g: [row for row in rows if row["group"] == g] for g in ("hidden", "partly", "seen")},
    }


def setup(wrong: Sequence[WrongSetup]) -> list[dict[str, Any]]:
    """Return the wrong setups of recordings, each with its fix."""
    return [
        {
            "recording": item.recording,
            "problem": problem(item),
            "cure": cure_of(item, wrong),
            "lines": map_lines(item),
        }
        for item in wrong
    ]


def findings(found: Diagnosis, cells: Cells) -> list[dict[str, Any]]:
    """Return the missing effects: title, law, coefficients, evidence, ties."""
    items = []
    for k, effect in enumerate(found.effects):
        place = f"diagnosis.effects.{k}"
        rows = []
        for name, estimate in effect.coefficients.items():
            at, pure = f"{place}.coefficients.{name}", is_pure(effect.name, name, estimate)
            model = ""
            if effect.in_model is not None:
                model = cells.estimate(f"{place}.in_model.{name}", estimate.unit, pure=pure)
            rows.append(
                {
                    "name": name,
                    "value": cells.estimate(at, estimate.unit, pure=pure),
                    "interval": cells.interval(at, estimate.unit, pure=pure),
                    "model": model,
                }
            )
        items.append(
            {
                "name": effect.name,
                "title": title(effect),
                "physics": physics(effect),
                "law": cells.shown(f"{place}.formula", typeset(effect.formula), "typeset"),
                "rows": rows,
                "in_model": effect.in_model is not None,
                "evidence": [
                    cells.words(f"{place}.evidence.{n}") for n in range(len(cells.at(f"{place}.evidence")))
                ],
                "ranks": _ranks(effect, cells, place),
                "ties": [
                    cells.shown(f"{place}.ties.{n}", tie_sentence(tie), "tie")
                    for n, tie in enumerate(effect.ties)
                ],
            }
        )
    return items


def _ranks(effect: EffectFinding, cells: Cells, place: str) -> list[dict[str, Any]]:
    """Return the explanations by what χ² loses with each: the finding, its ties, its rivals, and no explanation."""
    shown = [("found", effect.name, 0.0, Markup("–"), Markup(""))]
    for n, tie in enumerate(effect.ties):
        test = "none on this bench" if tie.separating_plan is None else f"plan {tie.separating_plan}"
        if tie.expected_separation is not None:
            test += f", expected Δχ² {tie.expected_separation:.0f}"
        number = cells.digits(f"{place}.ties.{n}.delta_chi2", 1)
        shown.append(
            ("tie", tie.name, tie.delta_chi2, number, cells.shown(f"{place}.ties.{n}", test, "test"))
        )
    first = len(cells.at(f"{place}.evidence")) - len(effect.rivals)  # their sentences are the last ones
    for n, rival in enumerate(effect.rivals):
        number = cells.shown(f"{place}.evidence.{first + n}", f"{rival.delta_chi2:.0f}", "rank")
        shown.append(("rival", rival.name, rival.delta_chi2, number, Markup("these recordings")))
    number = cells.digits(f"{place}.delta_chi2", 0)
    shown.append(("nothing", f"without {effect.name}", effect.delta_chi2, number, Markup("these recordings")))
    most = max(math.log1p(max(delta, 0.0)) for _, _, delta, _, _ in shown) or 1.0
    return [
        {
            "kind": kind,
            "name": name,
            "delta": number,
            "test": test,
            "width": round(100.0 * math.log1p(max(delta, 0.0)) / most, 1),
        }
        for kind, name, delta, number, test in sorted(shown, key=lambda row: row[2])
    ]


def instruments(found: Diagnosis, cells: Cells) -> list[dict[str, Any]]:
    """Return the wrong instruments."""
    numbered = list(enumerate(found.instruments))
    return [
        {
            "name": name,
            "title": own[0][1].title,
            "physics": own[0][1].sentence,
            "said": [cells.words(f"diagnosis.instruments.{k}.sentence") for k, _ in own],
            "delta": cells.digits(f"diagnosis.instruments.{own[0][0]}.delta_chi2", 0),
            "ties": [
                cells.shown(f"diagnosis.instruments.{own[0][0]}.ties.{n}", tie_sentence(tie), "tie")
                for n, tie in enumerate(own[0][1].ties)
            ],
        }
        for name, group in itertools.groupby(numbered, lambda item: item[1].name)
        for own in [list(group)]
    ]


def forms(found: Diagnosis, cells: Cells) -> list[dict[str, Any]]:
    """Return the proposed formulas."""
    items = []
    for k, form in enumerate(found.free_form):
        place = f"diagnosis.free_form.{k}"
        rows = [
            {"name": name, "value": cells.estimate(f"{place}.coefficients.{name}", e.unit, pure=True)}
            for name, e in form.coefficients.items()
        ]
        items.append(
            {
                "name": form.name or "proposed form",
                "law": cells.shown(f"{place}.formula", typeset(form.formula), "typeset"),
                "rows": rows,
                "delta": cells.digits(f"{place}.delta_chi2", 0),
                "simple": cells.shown(f"{place}.simple", typeset(form.simple), "typeset")
                if form.simple
                else "",
                "simple_said": cells.shown(f"{place}.simple", simple_sentence(form), "sentence"),
                "ties": [
                    cells.shown(f"{place}.ties.{n}", tie_sentence(tie), "tie")
                    for n, tie in enumerate(form.ties)
                ],
                "others": [(tie.name, f"{tie.name}: {tie.form.formula}") for tie in form.ties if tie.form],
            }
        )
    return items


def correction_map(found: Diagnosis, cells: Cells) -> dict[str, Any] | None:
    """Return the map of the missing torque, in sentences; None without one."""
    if found.map is None:
        return None
    count = len(cells.at("diagnosis.map.sentences"))
    return {
        "name": found.map.effect.name,
        "said": [cells.words(f"diagnosis.map.sentences.{n}") for n in range(count)],
    }


def readings(found: Diagnosis, cells: Cells) -> list[Any]:
    """Return the properties of instruments that the samples show."""
    # in the JSON they follow the instruments that the fit found
    first = len(found.instruments)
    return [cells.words(f"diagnosis.instruments.{first + k}.sentence") for k in range(len(found.readings))]


def remarks(found: Diagnosis, cells: Cells) -> list[Any]:
    """Return the coverage of the steady motion, and the properties that the samples cannot show."""
    part = found.coverage
    said = [] if part.complete else [cells.shown("diagnosis.coverage", f"{part.sentence()}.", "sentence")]
    return [*said, *untold_sentences(found.hum_unknown)]


def events(found: Diagnosis) -> list[str]:
    """Return the ties of events."""
    return [text for text in map(tie_of_event, found.events) if text]


def next_test(found: Diagnosis, cells: Cells) -> dict[str, Any] | None:
    """Return the test to run next."""
    if found.next_test is None:
        return None
    return {
        "settles": found.verdict not in ("nothing_missing", "effect"),
        "plan": found.next_test.plan,
        "minutes": cells.digits("diagnosis.next_test.minutes", 1),
        "separation": cells.digits("diagnosis.next_test.expected_separation", 0),
        "purpose": purpose(found.next_test),
    }


def error_rows(cells: Cells, place: str) -> dict[str, Any] | None:
    """Return the table of errors at a place of the JSON: before, after and noise, fitted and validation."""
    from gyrowheel_analysis.residuals.error_table import ErrorRow

    error = cells.at(place)
    if error is None:
        return None
    parts = [("fitted", "before", "after", "noise_floor")]
    if error["validation_after"] is not None:
        floor = "validation_noise_floor" if error["validation_noise_floor"] is not None else "noise_floor"
        parts.append(("not used to fit", "validation_before", "validation_after", floor))
    names = [name for name in LISTED if all(_where(error[key], name) for part in parts for key in part[1:])]

    def field(key: str, name: str) -> str:
        return f"{place}.{key}.{_where(error[key], name)}"

    units = unit_of({name: cells.at(field("noise_floor", name)) for name in names})
    errors = {key: ErrorRow.from_json(error[key]) for part in parts for key in part[1:]}
    rows = []
    for name in names:
        row = []
        for _, before, after, floor in parts:
            row.append(
                {
                    "before": cells.number(field(before, name), units[name]),
                    "after": cells.number(field(after, name), units[name]),
                    "noise": cells.number(field(floor, name), units[name]),
                    "mood": _mood(name, errors[before], errors[after], errors[floor]),
                }
            )
        rows.append({"name": LISTED[name].title, "unit": units[name].label, "parts": row})
    chi2 = [
        {
            "before": cells.number(f"{place}.{before}.chi2_per_n", _PLAIN),
            "after": cells.number(f"{place}.{after}.chi2_per_n", _PLAIN),
        }
        for _, before, after, _ in parts
    ]
    return {"parts": [part[0] for part in parts], "rows": rows, "chi2": chi2}


def _mood(name: str, before: ErrorRow, after: ErrorRow, floor: ErrorRow) -> str:
    """Return the colour of an error after: good where it fell to its noise, bad where it is above it, else none."""
    if not after.is_noise(name, floor):
        return "bad"
    return "" if before.is_noise(name, floor) else "good"


def symbols(model: Model, found: Diagnosis) -> list[dict[str, str]]:
    """Return the symbols of the laws in the report with their units: quantities of motion, then coefficients."""
    library = model.details.library
    laws = [effect.formula for effect in found.effects] + [form.formula for form in found.free_form]
    laws += [library[name].formula for name in model.effects]
    used = set(itertools.chain.from_iterable(re.findall(r"[A-Za-z_]\w*", law) for law in laws))
    rows = [
        {"symbol": pretty(name), "unit": pretty_unit(own.unit), "about": own.description}
        for name, own in QUANTITIES.items()
        if name in used
    ]
    named = dict.fromkeys([*(effect.name for effect in found.effects), *model.effects])
    rows += [
        {"symbol": c.name, "unit": pretty_unit(c.unit), "about": f"{c.description} ({name})"}
        for name in named
        if name in library and not isinstance(library[name], TorqueMap)
        for c in library[name].coefficients
    ]
    fixed_ones = (
        ("χ²/N", "mean square of the residual in units of its noise; 1 is noise alone"),
        ("Δχ²", "increase of the misfit without an effect, all else fitted again"),
        ("σ", "standard deviation; one standard error of an estimate"),
        ("1N, 2N", "once, twice a revolution"),
    )
    return [*rows, *({"symbol": symbol, "unit": "1", "about": about} for symbol, about in fixed_ones)]


def _where(row: Mapping[str, Any], name: str) -> str:
    """Return the place of a channel's error in a row; empty without one."""
    if name in row["rms"]:
        return f"rms.{name}"
    return f"channels.{name}.rms" if name in row["channels"] else ""


def regions(cells: Cells) -> list[dict[str, Any]]:
    """Return the regions where the model fails."""
    return [
        {
            "share": cells.percent(f"diagnosis.where.{k}.share_of_chi2"),
            "region": cells.words(f"diagnosis.where.{k}.region"),
            "description": cells.words(f"diagnosis.where.{k}.description"),
        }
        for k in range(len(cells.at("diagnosis.where")))
    ]


def moved(found: Diagnosis, cells: Cells) -> list[dict[str, Any]]:
    """Return the bench parameters that moved by more than their stated uncertainty."""
    return [
        {
            "name": name,
            "fitted": cells.estimate(f"diagnosis.nuisance.{name}", n.unit, pure=True),
            "stated": cells.estimate(
                f"diagnosis.nuisance.{name}", n.unit, pure=True, keys=("prior_value", "prior_uncertainty")
            ),
        }
        for name, n in found.nuisance.items()
        if n.prior_uncertainty > 0.0 and abs(n.pull) > _MOVED
    ]


def limits(found: Diagnosis, cells: Cells) -> list[dict[str, Any]]:
    """Return the detection limits, largest relative to the usual size first, each with a strip of the usual sizes."""
    rows = []
    for k, limit in enumerate(found.limits):
        finite = math.isfinite(limit.value)
        group = "hidden" if not limit.visible else "partly" if limit.value > limit.usual[0] else "seen"
        unit = unit_for(max(abs(v) for v in limit.usual), limit.unit)
        rows.append(
            {
                "group": group,
                "effect": limit.effect,
                "coefficient": limit.coefficient,
                "title": limit.title,
                "limit": cells.quantity(f"diagnosis.detection_limits.{k}.value", limit.unit)
                if finite
                else "never",
                "usual": (declared(limit.usual[0], unit), declared(limit.usual[1], unit), label(unit)),
                "strip": _strip(limit) if finite else None,
                "order": limit.value / limit.usual[1],
            }
        )
    return sorted(rows, key=lambda row: -row["order"])


def _strip(limit: DetectionLimit) -> dict[str, float]:
    """Return position and width of the usual sizes in a strip centred on the limit [per cent of its width]."""

    def place(value: float) -> float:
        decades = math.log10(value / limit.value) if value > 0.0 else -_DECADES
        return 50.0 * (1.0 + min(max(decades / _DECADES, -1.0), 1.0))

    low, high = (place(value) for value in limit.usual)
    low = min(low, 99.0)  # a band beyond the strip is seen at its end
    return {"left": round(low, 1), "width": round(max(high - low, 1.0), 1)}


def model_effects(model: Model, cells: Cells) -> list[dict[str, Any]]:
    """Return the effects of the model: law and coefficients with their sources."""
    library = model.details.library
    return [
        {
            "name": name,
            "title": library[name].title,
            "law": typeset(library[name].formula),
            "source": library[name].source,
            "range": range_text(own) if isinstance(own := library[name], TorqueMap) else "",
            "rows": []
            if isinstance(library[name], TorqueMap)  # it has dozens, of which none means anything alone
            else [
                {
                    "name": c.name,
                    "about": c.description,
                    "value": cells.estimate(
                        f"model.content.effects.{name}.{c.name}", c.unit, pure=c.shape is not None
                    ),
                }
                for c in library[name].coefficients
                if c.name in values
            ],
        }
        for name, values in model.effects.items()
    ]


def model_parameters(model: Model, cells: Cells) -> list[dict[str, Any]]:
    """Return every bench parameter: stated value with source, and fitted value."""
    return [
        {
            "name": name,
            "stated": cells.estimate(f"model.bench.{name}", p.unit, pure=True),
            "fitted": cells.estimate(f"model.content.overrides.{name}", p.unit, pure=True)
            if name in model.parameters
            else "",
            "source": p.source,
        }
        for name, p in model.stated_bench.parameters.items()
    ]


def history(model: Model, cells: Cells) -> list[dict[str, Any]]:
    """Return the changes of the model, oldest first."""
    return [
        {
            "time": str(entry.get("time", "")).replace("T", " ").removesuffix("+00:00"),
            "what": str(entry.get("what", "")),
            "fit": _names(entry.get("fit")),
            "validate": _names(entry.get("validate")),
            "fall": [
                [cells.number(f"{place}.{key}.chi2_per_n", _PLAIN) for key in pair]
                for place in [f"model.content.history.{k}.error"]
                for pair in (("before", "after"), ("validation_before", "validation_after"))
                if all(_has_chi2(entry.get("error"), key) for key in pair)
            ],
        }
        for k, entry in enumerate(model.history)
    ]


def _has_chi2(error: Any, key: str) -> bool:
    row = error.get(key) if isinstance(error, Mapping) else None
    return isinstance(row, Mapping) and isinstance(row.get("chi2_per_n"), float)


def _names(paths: Any) -> str:
    return ", ".join(Path(str(path)).name for path in paths) if isinstance(paths, Sequence) else ""


def recordings(given: Sequence[Recording], cells: Cells) -> Iterator[dict[str, Any]]:
    """Yield facts about each recording: length, samples, speeds, tilts, files with hashes."""
    for k, recording in enumerate(given):
        place, info = f"recordings.{k}", recording.info
        yield {
            "name": recording.name,
            "path": str(recording.path),
            "role": cells.at(f"{place}.role"),
            "bench": info.bench or "not stated",
            "machine": info.machine or "not stated",
            "duration": cells.digits(f"{place}.info.duration", 2),
            "samples": cells.digits(f"{place}.info.integrity.samples", 0),
            "rate": cells.digits(f"{place}.info.rate", 1),
            "complete": integrity_text(info.integrity),
            "speeds": [cells.digits(f"{place}.info.spin_rate.{n}", 0, Unit("rpm", RPM)) for n in (0, 1)],
            "tilts": [cells.digits(f"{place}.info.tilt.{n}", 2, Unit("°", DEG)) for n in (0, 1)],
            "holds": len(info.holds),
            "rigs": ", ".join(info.rigs),
            "files": [
                {
                    "name": file["name"],
                    "size": cells.number(f"{place}.files.{n}.size", _MEGABYTE, lambda v: short(v, 3)),
                    "sha256": file["sha256"],
                }
                for n, file in enumerate(cells.at(f"{place}.files"))
            ],
        }
