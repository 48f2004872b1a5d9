"""What the page shows of the desk: parts of HTML made by the same templates as the report, and numbers for pictures."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from gyrowheel.report import sections
from gyrowheel.report.cells import Cells
from gyrowheel.report.page import environment, style_sheet
from gyrowheel.text.formulas import pretty
from gyrowheel.text.recordings import integrity_text
from gyrowheel.workbench.desk import ROLES, Desk
from gyrowheel_analysis.channels import CHANNELS
from gyrowheel_core.errors import InputError
from gyrowheel_core.units import DEG, RPM, unit_for
from gyrowheel_sim.effects import registry

#: Panels of the signals: title with unit, size of the unit, columns with their labels.
PANELS: tuple[tuple[str, float, Mapping[str, str]], ...] = (
    ("tilt, °", DEG, {"tilt_x": "about x", "tilt_y": "about y"}),
    ("spin rate, rpm", RPM, {"spin_rate": "spin rate"}),
    ("coil voltage, V", 1.0, {"coil_voltage_x": "coil x", "coil_voltage_y": "coil y"}),
    ("motor voltage, V", 1.0, {"motor_voltage": "motor"}),
    ("motor current, A", 1.0, {"motor_current": "motor"}),
)
_MOST_POINTS = 4000


def state(desk: Desk) -> dict[str, Any]:
    """Return all that the page shows, but the signals."""
    job, trouble = desk.job, desk.trouble
    return {
        "version": desk.version,
        "job": None
        if job is None
        else {"title": job.title, "line": job.line, "seconds": round(time.monotonic() - job.began, 1)},
        "trouble": None if trouble is None else {"place": trouble.place, "sentence": trouble.sentence},
        "parts": {name: _part(name, desk) for name in ("recordings", "missing", "error", "model")},
        "signals": [
            {
                "key": own.key,
                "name": own.recording.name,
                "duration": own.recording.duration,
                "samples": len(own.recording),
            }
            for own in list(desk.opened.values())
        ],
        "windows": windows(desk),
        "fall": fall(desk),
    }


def page() -> str:
    """Return the page."""
    return (
        environment("gyrowheel.workbench")
        .get_template("workbench.html")
        .render(panels=[{"title": title, "columns": list(columns.values())} for title, _, columns in PANELS])
    )


def login(sentence: str) -> str:
    """Return the page that asks for the token."""
    return (
        environment("gyrowheel.workbench")
        .get_template("login.html")
        .render(sentence=sentence, style=style_sheet())
    )


def signal(desk: Desk, key: str, begin: float, end: float, points: int) -> bytes:
    """Return the signals of a recording in a span of time, for the picture.

    Parameters
    ----------
    desk : Desk
        The desk.
    key : str
        The recording, which is open.
    begin, end : float
        The span [s from its start].
    points : int
        Most points of a line.

    Returns
    -------
    bytes
        Little-endian: number of points as float64, times [s] as float64, then a float32 a point for every column of
        `PANELS` in its unit.

    Raises
    ------
    InputError
        If the recording is not open, or the span is none.
    """
    own = desk.opened.get(key)
    if own is None:
        raise InputError(f"recording {key!r}: is not open")
    if not (np.isfinite(begin) and np.isfinite(end) and begin < end):
        raise InputError(f"span: {begin:g} to {end:g} s is none")
    times = own.recording.time
    first, last = np.searchsorted(times, [begin, end])
    first, last = max(int(first) - 1, 0), min(int(last) + 1, len(times))
    parts: list[bytes] = []
    for _, size, columns in PANELS:
        for name in columns:
            places, values = own.signals[name].cut(first, last, min(max(points, 4), _MOST_POINTS))
            if not parts:
                at = np.interp(places, np.arange(first, last), times[first:last])
                parts += [np.array([len(at)], "<f8").tobytes(), at.astype("<f8").tobytes()]
            parts.append((values / size).astype("<f4").tobytes())
    return b"".join(parts)


def windows(desk: Desk) -> dict[str, Any] | None:
    """Return the windows of the comparison with their residuals, for the map and what is linked with it."""
    found = desk.step.comparison
    if found is None:
        return None
    data, keys = found.details.data, [own.key for own in desk.opened.values() if own.role == ROLES[0]]
    w, tilt = data.windows, data.parts["tilt"]
    unit = unit_for(float(np.median(np.abs(tilt.values))), "N·m")
    return {
        "recording": [keys[int(k)] for k in data.recording],
        "start": w.start.tolist(),
        "duration": w.duration.tolist(),
        "speed": (w.mean_spin / RPM).round(1).tolist(),
        "tilt_x": (np.real(w.mean_tilt) / DEG).round(4).tolist(),
        "tilt_y": (np.imag(w.mean_tilt) / DEG).round(4).tolist(),
        "residual_x": (np.real(tilt.values) / unit.size).tolist(),
        "residual_y": (np.imag(tilt.values) / unit.size).tolist(),
        "unit": unit.label,
        "chi2": {
            name: {"title": CHANNELS[name].title, "values": (part.squares / len(part.kind.rows)).tolist()}
            for name, part in data.parts.items()
        },
    }


def fall(desk: Desk) -> list[dict[str, Any]]:
    """Return how the error fell with the changes made here: χ²/N on fitted and on unused recordings."""
    rows: list[dict[str, Any]] = []
    for step in list(desk.steps):
        added = step.model.added
        if added is None:
            continue
        error, name = added.error, ", ".join(added.coefficients)
        if not rows:
            rows.append({"what": "before", **_chi2(error.before, error.validation_before)})
        rows.append({"what": f"+ {name}", **_chi2(error.after, error.validation_after)})
    return rows


def _chi2(fitted: Any, unused: Any) -> dict[str, float | None]:
    return {"fitted": fitted.chi2_per_n, "unused": None if unused is None else unused.chi2_per_n}


def formula(desk: Desk, text: str) -> dict[str, Any]:
    """Return how a formula is read: its law, and its coefficients with their units.

    Raises
    ------
    InputError
        If it cannot be read, or its units do not agree.
    """
    effect = desk.own(text)
    return {
        "name": effect.name,
        "law": pretty(effect.formula),
        "coefficients": [
            f"{c.name} in {unit_for(1.0, c.unit, pure=True).label or '1'}" for c in effect.coefficients
        ],
    }


def _part(name: str, desk: Desk) -> Markup:
    return Markup(
        environment("gyrowheel.workbench").get_template(f"bench_{name}.html").render(_CONTENT[name](desk))
    )


def _recordings(desk: Desk) -> dict[str, Any]:
    rows = []
    for entry in desk.shelf.entries():
        own = desk.opened.get(entry.key)
        facts = ""
        if own is not None:
            info = own.recording.info
            facts = f"{info.duration:.1f} s at {info.rate:.0f} Hz, {integrity_text(info.integrity)}"
        rows.append(
            {
                "key": entry.key,
                "name": entry.name,
                "size": f"{entry.size / 1e6:.1f} MB",
                "when": time.strftime("%Y-%m-%d %H:%M", time.localtime(entry.changed)),
                "role": "" if own is None else own.role,
                "facts": facts,
            }
        )
    return {"rows": rows, "roles": ROLES, "busy": desk.job is not None}


def _missing(desk: Desk) -> dict[str, Any]:
    result, inside = desk.step.diagnosis, set(desk.step.model.effects)
    shared: dict[str, Any] = {
        "ready": bool(desk.used(ROLES[0])),
        "busy": desk.job is not None,
        "added": desk.step.model.added is not None,
        "effects": sorted(name for name in registry() if name not in inside),
    }
    if result is None:
        return shared | {"found": None}
    found, cells = result.details, Cells({"diagnosis": result.to_dict()})
    limits = sections.limits(found, cells)
    return shared | {
        "found": found,
        "summary": cells.words("diagnosis.summary"),
        "mood": sections.MOOD[found.verdict],
        "proof": None if found.proof is None else cells.words("diagnosis.proof.reason"),
        "proven": None if found.proof is None else found.proof.proven,
        "findings": sections.findings(found, cells),
        "ties": {finding.name: [tie.name for tie in finding.ties] for finding in found.effects},
        "instruments": sections.instruments(found, cells),
        "forms": sections.forms(found, cells),
        "formulas": [f"{form.name}: {form.formula}" for form in found.free_form],
        "events": sections.events(found),
        "next_test": sections.next_test(found, cells),
        "regions": sections.regions(cells),
        "limits": {
            group: [row for row in limits if row["group"] == group] for group in ("hidden", "partly", "seen")
        },
    }


def _error(desk: Desk) -> dict[str, Any]:
    added, found = desk.step.model.added, desk.step.diagnosis
    result, name, text = (found, "diagnosis", "") if added is None else (added, "addition", str(added))
    if result is None:
        return {"error": None, "text": ""}
    return {"error": sections.error_rows(Cells({name: result.to_dict()}), f"{name}.error"), "text": text}


def _model(desk: Desk) -> dict[str, Any]:
    model = desk.step.model
    cells = Cells({"model": {"content": model.to_dict()}})
    return {
        "origin": model.origin,
        "bench": model.details.bench_source,
        "effects": sections.model_effects(model, cells),
        "history": sections.history(model, cells),
        "text": _yaml(model.to_dict()),
        "busy": desk.job is not None,
        "saved": desk.saved,
        "name": desk.file.name if desk.file is not None else "wheel.yaml",
    }


def _yaml(content: Mapping[str, Any]) -> str:
    import yaml

    shown = {key: value for key, value in content.items() if key != "history"}
    return yaml.safe_dump(shown, sort_keys=False, width=100, default_flow_style=None, allow_unicode=True)


_CONTENT = {"recordings": _recordings, "missing": _missing, "error": _error, "model": _model}
