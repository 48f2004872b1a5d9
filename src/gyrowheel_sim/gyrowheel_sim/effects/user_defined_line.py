"""User-defined effects in one line of text, for command lines and text fields: read and written.

``stator_pull: torque = -k*r^2*z; k [N*m/rad]`` is the whole; a law alone is enough where its coefficients have names of
one letter: ``-k*r^2*z`` declares ``k``, whose unit follows. A law with a memory has the rate of its state, and where it
is not zero its value at the first sample: ``-k*s; d(s)/dt = (z - s)/tau; s(0) = z; tau = 5 +- 3 [s]``.
"""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.dimensions import MissingUnitError, Unit, check_unit
from gyrowheel_sim.effects.formula import Formula, read, to_text
from gyrowheel_sim.effects.grammar import MAX_LENGTH, NAME, shortened, unknown_names
from gyrowheel_sim.effects.memory import Memory
from gyrowheel_sim.effects.targets import TARGETS
from gyrowheel_sim.effects.user_defined import LAW_FIELDS, effect_from_mapping, effect_to_mapping

_FORM = "expected NAME: TARGET = FORMULA; COEFFICIENT [UNIT]; ..."
#: The left side of a rate, ``d(s)/dt`` or ``s'``, and of a start value, ``s(0)``.
_RATE = re.compile(rf"d\s*\(\s*({NAME.pattern})\s*\)\s*/\s*dt|({NAME.pattern})'")
_START = re.compile(rf"({NAME.pattern})\s*\(\s*0\s*\)")
_PREFIX = re.compile(rf"\s*({NAME.pattern})\s*:(.*)", re.DOTALL)
#: A name of one letter, numbered or with an index at most: ``k``, ``k2``, ``F_x``.
_LETTER = re.compile(r"[A-Za-z](?:[0-9]|_[A-Za-z0-9])?")
#: With more undeclared coefficients than this, their units must be given.
_MOST_INFERRED = 6
_FLOAT = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_COEFFICIENT = re.compile(
    rf"(?P<name>\w+)\s*(?:=\s*(?P<value>{_FLOAT})\s*(?:(?:\+-|±)\s*(?P<uncertainty>{_FLOAT})\s*)?)?"
    r"(?:\[(?P<unit>[^\]]*)\])?"
)
Laws = dict[str, str]
Entries = dict[str, dict[str, Any]]  # of coefficients, or of states


def effect_from_text(text: str, where: str = "formula") -> Effect:
    """Return the effect that a line of text declares.

    `text`: ``NAME: TARGET = FORMULA; COEFFICIENT [UNIT]; ...`` with as many laws and coefficients as needed, and
    ``d(STATE)/dt = FORMULA; STATE(0) = FORMULA; STATE [UNIT]`` for each state.
    A coefficient may have its usual size, or a shape its value and uncertainty: ``k = 0.02 [N*m/rad]``, ``p =
    0.6 +- 0.05 [1]``. `where`: what messages begin with. Raises InputError as
    `gyrowheel_sim.effects.user_defined.effect_from_mapping`, or if the line is not of that form.
    """
    name, colon, rest = str(text).partition(":")
    if not colon:
        raise InputError(f"{where}: {shortened(str(text))} has no name; {_FORM}")
    laws, states, coefficients = _parts(rest, where)
    return effect_from_mapping(
        name.strip(), {**laws, "states": states, "coefficients": coefficients}, f"{where}: {name.strip()}"
    )


def typed_effect(
    text: str,
    *,
    name: str | None = None,
    otherwise: str | None = None,
    target: str | None = None,
    where: str = "formula",
) -> Effect:
    """Return the effect that a user has typed in one line, with parts left out.

    Parameters
    ----------
    text : str
        As `effect_from_text` reads it, but the name may be given apart, ``TARGET =`` may be left out, a unit may be
        left out where it follows from the law, and so may the whole coefficient if its name is a single letter (``k``,
        ``k2``, ``F_x``) in which the law is linear.
    name : str, optional
        Name of the effect; where the text has one, the same.
    otherwise : str, optional
        Name of the effect where there is no other.
    target : str, optional
        What a law without ``TARGET =`` acts on; the torque on the rotor if not given.
    where : str
        What messages begin with.

    Raises
    ------
    InputError
        As `effect_from_text`; if there is no name, or two that differ; if the target is not known.
    """
    text = str(text)
    if len(text) > 4 * MAX_LENGTH:
        raise InputError(f"{where}: the text has {len(text)} characters; allowed: up to {4 * MAX_LENGTH}")
    match = _PREFIX.fullmatch(text)
    if match is not None:
        if name is not None and name != match[1]:
            raise InputError(f"{where}: the text names it '{match[1]}', not '{name}'; give one name")
        name, text = match[1], match[2]
    name = name or otherwise
    if name is None:
        raise InputError(f"{where}: the effect needs a name, e.g. stator_pull: {' '.join(text.split())[:60]}")
    target = target or "rotor_torque"
    if target not in LAW_FIELDS:
        raise InputError(f"{where}: target '{target[:60]}' is not known; allowed: {', '.join(TARGETS)}")
    laws, states, coefficients = _parts(text, where, LAW_FIELDS[target])
    formulas_typed = [
        *laws.values(),
        *(own[key] for own in states.values() for key in ("rate", "start") if key in own),
    ]
    letters = [
        n for law in formulas_typed for n in unknown_names(law) if _LETTER.fullmatch(n) and n not in states
    ]
    coefficients |= {letter: {} for letter in letters if letter not in coefficients}
    units = {key: entry["unit"] for key, entry in coefficients.items() if "unit" in entry}
    # errors of a formula come before conclusions from it
    memory = Memory.read(
        {key: (own.get("unit"), own["rate"], own.get("start", "0")) for key, own in states.items()},
        list(coefficients),
        f"{where}: {name}",
    )
    names = [*coefficients, *states]
    formulas: list[tuple[Formula, str]] = [
        (read(law, names, f"{where}: {name}.{left}", memory.two), TARGETS[left].unit)
        for left, law in laws.items()
    ]
    memory = memory.with_units(units)
    for key, own in states.items():
        own["unit"] = memory.units[key]
    missing = [key for key in coefficients if key not in units]
    known = units | dict(memory.units)
    for key, unit in _units(formulas + memory.wanted, missing, known).items():
        coefficients[key]["unit"] = unit
    declared = {**laws, "states": states, "coefficients": coefficients}
    return effect_from_mapping(name, declared, f"{where}: {name}")


def effect_to_line(effect: Effect) -> str:
    """Return laws and coefficients of an effect in one line, without its name, as `typed_effect` reads them.

    The line has no usual sizes and bounds of amplitudes, and no descriptions.
    """
    mapping = effect_to_mapping(effect)
    laws = [f"{target} = {mapping[target]}" for target in TARGETS if target in mapping]
    shapes = {
        c.name: f" = {c.shape:.6g} +- {c.shape_uncertainty:.3g}"
        for c in effect.coefficients
        if c.shape is not None
    }
    for s in effect.states:
        start = f"; {s.name}(0) = {to_text(s.start)}" if s.start != 0 else ""
        laws.append(f"d({s.name})/dt = {to_text(s.rate)}{start}; {s.name} [{s.unit}]")
    return "; ".join([*laws, *(f"{c.name}{shapes.get(c.name, '')} [{c.unit}]" for c in effect.coefficients)])


def _parts(text: str, where: str, target: str | None = None) -> tuple[Laws, Entries, Entries]:
    """Return the laws of a line by their targets, and its states and coefficients as a declaration has them.

    With a `target`, the first part may be a law without ``TARGET =``, and ``torque`` is named as the target it means.
    """
    laws: Laws = {}
    states: Entries = {}
    coefficients: Entries = {}
    parts = [part for part in (" ".join(part.split()) for part in text.split(";")) if part]
    for index, part in enumerate(parts):
        left, equals, right = (piece.strip() for piece in part.partition("="))
        if equals and (found := _RATE.fullmatch(left) or _START.fullmatch(left)):
            state = states.setdefault(next(filter(None, found.groups())), {})
            key = "rate" if found.re is _RATE else "start"
            if key in state:
                raise InputError(f"{where}: {left} is given twice; write a sum")
            state[key] = right
            continue
        if target is not None:
            left, right = (target, part) if not equals and not index else (LAW_FIELDS.get(left, left), right)
        if left in LAW_FIELDS and (equals or not index):
            if left in laws:
                raise InputError(f"{where}: {left} is given twice; write a sum")
            laws[left] = right
            continue
        match = _COEFFICIENT.fullmatch(part)
        if match is None:
            raise InputError(f"{where}: '{shortened(part)}' is neither a law nor a coefficient; {_FORM}")
        if match["name"] in coefficients:
            raise InputError(f"{where}: the coefficient {match['name']} is given twice")
        entry: dict[str, Any] = {"unit": match["unit"]} if match["unit"] is not None else {}
        entry |= {key: float(match[key]) for key in ("value", "uncertainty") if match[key] is not None}
        coefficients[match["name"]] = entry
    for name, state in states.items():
        if "rate" not in state:
            raise InputError(f"{where}: {name}(0) has no rate; d({name})/dt = FORMULA is needed")
        stated = coefficients.pop(name, {})
        if "value" in stated:
            raise InputError(
                f"{where}: {name} is a state; its value at the start is {name}(0) = {stated['value']:g}"
            )
        state |= stated
    return laws, states, coefficients


def _units(
    laws: Sequence[tuple[Formula, str]], wanted: Sequence[str], units: Mapping[str, str]
) -> dict[str, str]:
    """Return the units of coefficients that follow from those of the targets and of the other coefficients.

    One is looked at after the other: those not known yet are zero, which ends the terms that have them, and some of
    them one where that leaves nothing or divides by it.
    """
    found: dict[str, str] = {}
    if len(wanted) > _MOST_INFERRED:
        return found
    for name in wanted:
        unit = _unit(laws, name, dict.fromkeys((n for n in wanted if n != name), 0), units)
        found |= {name: unit} if unit else {}
    for name in wanted:
        others = [n for n in wanted if n not in (name, *found)]
        choices = sorted(itertools.product((0, 1), repeat=len(others)), key=sum)
        for choice in choices if name not in found else ():
            unit = _unit(laws, name, dict(zip(others, choice, strict=True)), {**units, **found})
            if unit:
                found[name] = unit
                break
    return found


def _unit(
    laws: Sequence[tuple[Formula, str]], name: str, others: Mapping[str, int], units: Mapping[str, str]
) -> str | None:
    """Return the unit of one coefficient, numbers standing in for `others`; None if it does not follow."""
    for formula, wanted in laws:
        # errors are reported when the whole line is read
        with contextlib.suppress(InputError):
            try:
                check_unit(formula.with_numbers(others), {**units, name: None}, wanted)
            except MissingUnitError as error:
                return str(Unit.of(str(error.unit)))
    return None
