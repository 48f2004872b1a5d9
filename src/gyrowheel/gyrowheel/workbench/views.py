"""Words and tables of the page: parts of HTML from the templates of the report."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from gyrowheel.comparison.page import verdict as comparison_verdict
from gyrowheel.recordings.page import integrity_text
from gyrowheel.report import sections
from gyrowheel.show.figure import PANELS
from gyrowheel.show.formulas import pretty, typeset
from gyrowheel.show.html import Cells, declared, environment, label, style_sheet
from gyrowheel.show.sentences.diagnosis import purpose
from gyrowheel.show.sentences.proof import proof_sentence
from gyrowheel.workbench.benches import SimulatedBench
from gyrowheel.workbench.derived import NAMES
from gyrowheel.workbench.library import ROLES, Opened
from gyrowheel.workbench.report import MODEL
from gyrowheel.workbench.session import NO_BENCH, Session
from gyrowheel.workbench.tables import LARGEST
from gyrowheel.workbench.trace import BIN_NS, KEPT, ROW, SETPOINTS
from gyrowheel_control.plans.plan import Plan
from gyrowheel_core.errors import InputError, nearest
from gyrowheel_core.quantities import fixed
from gyrowheel_core.units import DEG, RPM, unit_for
from gyrowheel_core.wire import SECOND
from gyrowheel_sim.effects import registry
from gyrowheel_sim.effects.quantities import QUANTITIES

if TYPE_CHECKING:
    import jinja2

    from gyrowheel_recording.bags import RecordingInfo

#: Number of recordings that the page lists, latest first.
MOST_LISTED = 500

#: Units offered for the columns of a table; others are allowed.
_UNITS = (
    "s", "ms", "us", "ns", "timestamp", "deg", "rad", "mrad", "rpm", "rad/s", "deg/s", "turn", "count", "V", "mV",
    "A", "mA", "K", "degC", "Pa", "hPa", "kPa", "bar",
)  # fmt: skip


def _templates() -> jinja2.Environment:
    return environment("gyrowheel.workbench", "gyrowheel.report")


def state(session: Session) -> dict[str, Any]:
    """Return the state of the page, without the numbers of its pictures."""
    job, trouble, opened = session.job, session.trouble, list(session.opened.values())
    alike = Counter(own.recording.name for own in opened)
    return {
        "version": session.version,
        "job": None
        if job is None
        else {
            "title": job.title,
            "line": job.line,
            "part": job.part,
            "seconds": round(time.monotonic() - job.began, 1),
        },
        "trouble": None if trouble is None else {"place": trouble.place, "sentence": trouble.sentence},
        "parts": {name: _part(name, session) for name in _CONTENT},
        "signals": [
            {
                "key": own.key,
                "name": own.recording.name
                if alike[own.recording.name] == 1
                else f"{own.recording.path.absolute().parent.name}/{own.recording.name}",
                "duration": own.recording.duration,
                "samples": len(own.recording),
                "uses": _uses(session, own),
            }
            for own in opened
        ],
        "derived": [{"name": own.text, "title": own.title} for own in session.derived],
        "facts": session.facts,
        # version of the drawn holds of running benches: not their position, which changes all the time
        "heard": [
            f"{key} {run.start_ns} {len(run.holds)} {run.holds[-1].stamp_ns}"
            for key, run in session.live.runs.items()
            if run.holds
        ],
        "live": {
            key: {
                "title": run.title,
                "words": run.words(),
                "silent": run.silent,
                "allowed": asdict(session.allowed(key)),
            }
            for key, run in session.live.runs.items()
        },
    }


#: What the page calls a use.
USED = {"fitted": "fit", "not used to fit": "only predict", "left out": "leave out"}


def _uses(session: Session, own: Opened) -> list[dict[str, Any]]:
    """Return the ranges of a recording with their uses, in order of time; one if all of it has the same."""
    return [
        {"from": max(each.begin, 0.0), "until": min(each.end, own.recording.duration), "use": each.use}
        for each in own.uses(session.step.ranges.get(own.key, ()))
    ]


def page() -> str:
    """Return the page."""
    return (
        _templates()
        .get_template("workbench.html")
        .render(
            panels=[
                {
                    "title": title,
                    "columns": [{"name": name, "label": label} for name, label in columns.items()],
                }
                for title, _, columns in PANELS
            ],
            largest=LARGEST,
            uses=USED,
            names=NAMES,
            plans=_plans(),
            quantities={name: own.unit for name, own in QUANTITIES.items()},
            trace={"bin": BIN_NS / SECOND, "kept": KEPT, "row": [*ROW, *SETPOINTS]},
        )
    )


def help_page() -> str:
    """Return the help page."""
    template = _templates().get_template("help.html")
    return template.render(style=style_sheet(), quantities=QUANTITIES)


def effect_page(session: Session, name: str) -> str:
    """Return the page of an effect of the library or of the model; InputError for an unknown name."""
    library = session.step.model.details.library
    if name not in library:
        raise InputError(f"effect: {name!r} is not known; {nearest(name, library)}")
    own = library[name]
    rows = []
    for c in own.coefficients:
        unit = unit_for(max(abs(v) for v in c.usual), c.unit)
        low, high = (declared(v, unit) for v in c.usual)
        rows.append(
            {
                "name": c.name,
                "about": c.description,
                "usual": f"{low} … {high} {label(unit)}",
                "source": c.source,
            }
        )
    return (
        _templates()
        .get_template("effect.html")
        .render(style=style_sheet(), own=own, law=typeset(own.formula), rows=rows, library=library)
    )


def login(sentence: str) -> str:
    """Return the page that requests the token."""
    return _templates().get_template("login.html").render(sentence=sentence, style=style_sheet())


def formula(session: Session, text: str) -> dict[str, Any]:
    """Return the parsed formula: its law, and its coefficients with their units."""
    effect = session.own(text)
    return {
        "name": effect.name,
        "law": pretty(effect.formula),
        "coefficients": [
            f"{c.name} in {unit_for(1.0, c.unit, pure=True).label or '1'}" for c in effect.coefficients
        ],
    }


def _part(name: str, session: Session) -> Markup:
    return Markup(_templates().get_template(f"bench_{name}.html").render(_CONTENT[name](session)))


def _recordings(session: Session) -> dict[str, Any]:
    rows: list[dict[str, Any]] = []
    more = 0
    for place, entry in enumerate(session.library.listed()):
        own = session.opened.get(entry.key)
        if place >= MOST_LISTED and own is None:
            more += 1
            continue
        described = own is not None and own.described
        length = "" if entry.duration is None else f"{entry.duration:.1f} s, "
        rows.append(
            {
                "key": entry.key,
                "name": entry.name,
                "inside": entry.inside,
                "size": f"{'' if described else length}{entry.size / 1e6:.1f} MB",
                "when": time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.changed)),
                "role": "" if own is None else own.role,
                "growing": entry.growing,
                "facts": "; ".join(_facts(own.recording.info)) if own and described else "",
                "ranges": "" if own is None else _ranges(_uses(session, own)),
                "changed": own is not None and own.recording.data.is_changed,
            }
        )
    listed = {row["key"] for row in rows}
    rows += [
        {"key": key, "name": own.recording.name, "size": "no longer there", "role": own.role, "changed": True}
        for key, own in list(session.opened.items())
        if key not in listed
    ]
    return {
        "rows": rows,
        "more": more,
        "roles": ROLES,
        "busy": session.job is not None,
    }


def _live(session: Session) -> dict[str, Any]:
    return {"running": session.live.runs}


def _plans() -> dict[str, str]:
    """Return the shipped plans with their lengths."""
    return {name: f"{name}, {Plan.load(name).duration / 60.0:.1f} min" for name in Plan.shipped()}


def _ranges(uses: Sequence[Mapping[str, Any]]) -> str:
    """Return the ranges of a recording in words; empty where all of it has one use."""
    if len(uses) == 1:
        return ""
    said = USED | {"left out": "left out"}
    return "; ".join(f"{own['from']:.4g} … {own['until']:.4g} s {said[own['use']]}" for own in uses)


def _facts(info: RecordingInfo) -> Iterator[str]:
    """Yield facts about a recording: length and integrity, range of motion, bench and machine."""
    yield f"{info.duration:.1f} s at {info.rate:.0f} Hz, {integrity_text(info.integrity)}"
    (slow, fast), tilt = info.spin_rate, info.tilt[1]
    been = [f"{slow / RPM:.0f} … {fast / RPM:.0f} rpm"] if math.isfinite(slow + fast) else []
    been += [f"tilt up to {tilt / DEG:.1f}°"] if math.isfinite(tilt) else []
    been += [f"{len(info.holds)} holds"] if info.holds else []
    yield from [", ".join(been)] if been else []
    of = [f"bench {info.bench}"] if info.bench else []
    of += [f"machine {info.machine}"] if info.machine else []
    yield from [", ".join(of)] if of else []


def _table(session: Session) -> dict[str, Any]:
    return {"draft": session.table, "units": _UNITS}


def _verdict(session: Session) -> dict[str, Any]:
    """Return what is known of the model, and what to do next."""
    step, added = session.step, session.step.model.added
    shown: dict[str, Any] = {
        "mood": "open",
        "proof": None,
        "proven": None,
        "name": None,
        "busy": session.job is not None,
    }
    if (found := step.diagnosis) is not None:
        cells = Cells({"diagnosis": found.to_dict()})
        shown |= {
            "mood": sections.MOOD[found.verdict],
            "name": found.verdict,
            "words": cells.words("diagnosis.summary"),
            "proof": None if found.proof is None else cells.words("diagnosis.proof.reason"),
            "proven": None if found.proof is None else found.proof.proven,
        }
    elif added is not None and step.comparison is not None:
        shown |= {
            "words": added.headline(),
            "proof": proof_sentence(added.proof, added.error),
            "proven": added.proof.proven,
        }
    elif step.comparison is not None:
        chi2 = fixed(step.comparison.error_before.chi2_per_n)
        shown |= {"words": f"{comparison_verdict(step.comparison)}: χ²/N is {chi2} (1: noise)."}
    elif session.used(ROLES[0]):
        shown |= {"words": "The model is not compared with these recordings yet."}
    else:
        shown |= {"words": "No recording is open to fit."}
    return shown | {"next": {"do": "", "plan": "", "what": "", "focus": "", "link": ""} | _next(session)}


def _next(session: Session) -> dict[str, Any]:
    """Return the next step: a sentence, and the action of its button where there is one."""
    step, found = session.step, session.step.diagnosis
    if not session.used(ROLES[0]):
        if session.library.listed() or session.opened:
            return {"words": "Press fit at a recording on the left."}
        words = "Record two tests on a simulated machine."
        return {"words": words, "do": "demonstrate", "label": "Make the demonstration"}
    if found is None:
        words = (
            "See what is left of the error." if step.model.added else "See where the model fails, and why."
        )
        return {"words": words, "do": "diagnose", "label": "Compare and diagnose"}
    if found.setup:
        return {"words": "Correct the recording as it says under What is missing, and open it again."}
    if all_of := _to_add(session):
        what, label = ("it", f"Add {all_of[0]}") if len(all_of) == 1 else ("them", f"Add all {len(all_of)}")
        return {"words": f"Add {what} to the model.", "do": "add_all", "label": label}
    if found.map is not None:
        words = "No known law explains it; its map corrects the model."
        return {"words": words, "do": "add", "what": "map", "label": "Add the map"}
    if found.verdict != "nothing_missing" and found.next_test is not None:
        plan = found.next_test.plan
        runs = {"do": "test", "label": f"Run {plan}", "plan": plan} if _simulated(session) else {}
        return {"words": f"Run plan {plan}: {purpose(found.next_test)}."} | runs
    if found.verdict != "nothing_missing":
        words = "Add an effect that you suspect, or type its law as a formula."
        return {"words": words, "focus": "formula", "label": "Type a formula"}
    if session.step.model is not session.kept:
        return {"words": "Save the model.", "focus": "save-name", "label": "Save it"}
    if session.report is None:
        return {"words": "Write the report.", "do": "report", "label": "Write the report"}
    return {"words": "The report is written.", "link": "/report", "label": "Open the report"}


def _to_add(session: Session) -> list[str]:
    """Return the names of all that the diagnosis found."""
    return [item if isinstance(item, str) else item.name for item in session.missing()]


def _bar(session: Session) -> dict[str, Any]:
    model = session.step.model
    return {
        "busy": session.job is not None,
        "undo": len(session.steps) > 1 or bool(model.history),
        "redo": bool(session.undone),
        "saved": session.saved,
        "unsaved": model is not session.kept,
        "name": session.file.name if session.file is not None else MODEL,
    }


def _missing(session: Session) -> dict[str, Any]:
    result, comparison, model = session.step.diagnosis, session.step.comparison, session.step.model
    inside = set(model.effects)
    shared: dict[str, Any] = {
        "ready": bool(session.used(ROLES[0])),
        "changed": [
            own.recording.name for own in list(session.opened.values()) if own.recording.data.is_changed
        ],
        "busy": session.job is not None,
        "added": model.added is not None,
        "all": _to_add(session),
        "effects": sorted(name for name in registry() if name not in inside),
    }
    if result is None:
        wrong = () if comparison is None else comparison.setup
        return shared | {"found": None, "setup": sections.setup(wrong)}
    found, cells = result, Cells({"diagnosis": result.to_dict()})
    shown = sections.of_diagnosis(found, cells)
    return (
        shared
        | shown
        | {
            "found": found,
            "report": session.report is not None,
            "findings": [
                item | {"page": item["name"] in model.details.library} for item in shown["findings"]
            ],
            "ties": {
                finding.name: list(dict.fromkeys(name for tie in finding.ties for name in tie.names))
                for finding in found.effects
            },
            "formulas": [f"{form.name}: {form.formula}" for form in found.free_form],
            "simple": [f"{form.name}: {form.simple}" for form in found.free_form],
            "tests": session.tests(),
            "runs_here": _simulated(session),
            "benches": {key: run.title for key, run in session.live.runs.items() if not run.silent},
            "no_bench": NO_BENCH,
        }
    )


def _error(session: Session) -> dict[str, Any]:
    added, found = session.step.model.added, session.step.diagnosis
    if added is not None and session.step.comparison is not None:
        text = f"{added.headline()} {proof_sentence(added.proof, added.error)}"
        return {
            "error": sections.error_rows(Cells({"addition": added.to_dict()}), "addition.error"),
            "text": text,
        }
    if found is not None:
        rows = sections.error_rows(Cells({"diagnosis": found.to_dict()}), "diagnosis.error")
        return {"error": rows, "text": ""}
    return {"error": None, "text": ""}


def _model(session: Session) -> dict[str, Any]:
    model = session.step.model
    cells = Cells({"model": {"content": model.to_dict()}})
    return {
        "origin": model.origin,
        "bench": model.details.bench_source,
        "effects": sections.model_effects(model, cells),
        "history": sections.history(model, cells),
        "text": _yaml(model.to_dict()),
        "busy": session.job is not None,
    }


def _yaml(content: Mapping[str, Any]) -> str:
    import yaml

    shown = {key: value for key, value in content.items() if key != "history"}
    return yaml.safe_dump(shown, sort_keys=False, width=100, default_flow_style=None, allow_unicode=True)


def _simulated(session: Session) -> bool:
    try:
        return SimulatedBench.of(session.used(ROLES[0])) is not None
    except InputError:
        return False


_CONTENT = {
    "bar": _bar,
    "verdict": _verdict,
    "live": _live,
    "recordings": _recordings,
    "table": _table,
    "missing": _missing,
    "error": _error,
    "model": _model,
}
