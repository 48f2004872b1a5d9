"""A bench file to begin with: a copy of another bench, each value with what it is, its unit, uncertainty and source."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import asdict
from typing import Final

from gyrowheel_core.units import conversion
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.parameter import INSTRUMENTS, Parameter, default_text, description_of

#: Units in which people know the values of these parameters.
_SHOWN: Final = {
    "spin_rate_reference": "rpm",
    "spin_rate_minimum": "rpm",
    "spin_rate_maximum": "rpm",
    "tilt_reference": "deg",
    "tilt_limit": "deg",
}
_LINE: Final = re.compile(r"^  (?:# (?P<title>.*?)-*$|(?P<name>\w+): \{)")
_HEAD: Final = """\
# The bench {name}, begun as a copy of the bench {like}. docs/your_bench.md shows the way from here.
# Change every value that is another on your machine, with uncertainty and source; keep `assumed` where nobody knows.
#   value, unit    any unit of the kind: kg*m^2 or g*cm^2, rad/s or rpm, rad or deg, K or degC
#   uncertainty    standard uncertainty (1 sigma): in the unit of the value, or in per cent of it
#   source         where the value comes from: data sheet, drawing, measurement, or `assumed`
# `gyrowheel bench --bench FILE` shows it, and with --reach what it can reach; what is wrong is told all at once.
schema: 1
name: {name}
title: {title}
{references}
# Gains are rates, filters and shares of the bench's own momentum and inertia: these serve benches of any size.
controller:
  spin_loop: {spin_loop}  # pi, or pll: phase-locked
  # gains: {gains}
parameters:
"""


def bench_text(like: Bench, name: str) -> str:
    """Return the text of a bench file with the values of another bench.

    Parameters
    ----------
    like : Bench
        The bench to begin with.
    name : str
        Name of the new one.
    """
    gains = ", ".join(f"{key}: {value:g}" for key, value in asdict(like.gains).items())
    references = "".join(f"  {key}: {_quoted(text)}\n" for key, text in like.references.items())
    head = _HEAD.format(
        name=json.dumps(name) if not re.fullmatch(r"[A-Za-z]\w*", name) else name,
        like=like.name,
        title=_quoted(f"like {like.name}: {like.title}"),
        references=f"references:\n{references}".rstrip() if references else "",
        spin_loop=like.spin_loop,
        gains=f"{{{gains}}}",
    )
    return head + "\n".join(_lines(like)) + "\n"


def _lines(like: Bench) -> Iterator[str]:
    shared: dict[str, list[str]] = {}
    for p in like.parameters.values():
        shared.setdefault(p.group, []).append(p.name)
    for line in default_text().splitlines():
        found = _LINE.match(line)
        if found is None:
            continue
        if found["title"] is not None:
            title = found["title"].strip()
            yield f"\n  # ---- {title}"
            continue
        p = like.parameters[found["name"]]
        others = [name for name in shared[p.group] if name != p.name]
        along = f"; its uncertainty is common with {', '.join(others)}" if others else ""
        perfect = "; may be left out: perfect then" if p.name in INSTRUMENTS else ""
        yield f"  # {p.description}{along}{perfect}"
        yield f"  {p.name}: {_entry(p, like.name)}"


def _entry(p: Parameter, like: str) -> str:
    unit, value, size = p.unit, p.value, p.uncertainty
    if p.name in _SHOWN:
        unit = _SHOWN[p.name]
        _, factor = conversion(unit, p.unit)
        value, size = float(f"{value / factor:.12g}"), size / factor
    share = 100.0 * size / abs(value) if value else 0.0
    whole = share > 0.0 and math.isclose(float(f"{share:.3g}"), share, rel_tol=1e-9)
    spread = f"{share:.3g} %" if whole else f"{size:.6g}"
    source = p.source if p.source.startswith(("assumed", "as ")) else f"as {like}: {p.source}"
    shown = f'"{unit}"' if unit == "1" else unit
    parts = {"value": repr(value), "unit": shown, "uncertainty": spread, "source": _quoted(source)}
    if p.description != description_of(p.name):
        parts["description"] = _quoted(p.description)
    return f"{{{', '.join(f'{key}: {text}' for key, text in parts.items())}}}"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
