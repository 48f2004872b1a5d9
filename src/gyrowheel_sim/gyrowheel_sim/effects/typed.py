"""Effects typed in one line, as a command line or a text field takes them, and written so that they can be typed.

A law alone is enough where its coefficients have names of one letter: ``-k*r^2*z`` declares ``k``, whose unit follows.
"""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Mapping, Sequence

from gyrowheel_core.errors import InputError
from gyrowheel_sim.effects.declaration import Effect
from gyrowheel_sim.effects.dimensions import MissingUnitError, Unit, check_unit
from gyrowheel_sim.effects.formula import MAX_LENGTH, NAME, RESERVED, read
from gyrowheel_sim.effects.targets import TARGETS
from gyrowheel_sim.effects.user import LAW_FIELDS, effect_from_text, effect_to_mapping

_PREFIX = re.compile(rf"\s*({NAME.pattern})\s*:(.*)", re.DOTALL)
#: A name of one letter, numbered or with an index at most: ``k``, ``k2``, ``F_x``.
_LETTER = re.compile(r"[A-Za-z](?:[0-9]|_[A-Za-z0-9])?")
#: With more undeclared coefficients than this, their units must be given.
_MOST_INFERRED = 6
_DECLARED = re.compile(r"([A-Za-z]\w*)(?:\s*=[-+.±\s0-9eE]*)?\s*(?:\[([^\]]*)\])?")
#: Exponents with n as they are shown.
_RAISED = re.compile(r"ⁿ([⁻⁺][⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
_WORD = re.compile(
    r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|([A-Za-z_][A-Za-z0-9_]*)(?![A-Za-z0-9_₀'])"
)


def typed_effect(
    text: str,
    *,
    name: str | None = None,
    otherwise: str | None = None,
    target: str | None = None,
    where: str = "formula",
) -> Effect:
    """Return the effect that a user has typed in one line.

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
    known = _known_target(target or "rotor_torque", where)
    items = [_item(part, known, first=not index) for index, part in enumerate(_parts(text))]
    laws = [(left, right) for left, _, right in (item.partition(" = ") for item in items) if left in TARGETS]
    rest = [item for item in items if item.partition(" = ")[0] not in TARGETS]
    declared = {m[1]: m[2] for item in rest if (m := _DECLARED.fullmatch(item))}
    letters = [letter for letter in _letters([law for _, law in laws]) if letter not in declared]
    for left, law in laws:  # what is no formula is said before anything is concluded from it
        read(law, [*declared, *letters], f"{where}: {name}.{left}")
    units = {key: unit for key, unit in declared.items() if unit is not None}
    # shapes before amplitudes: of those a number stands in for one of the shapes may be wrong, as within exp
    units = _units(laws, [key for key in (*declared, *letters) if key not in units], units)
    rest = [
        f"{item} [{units[m[1]]}]" if (m := _DECLARED.fullmatch(item)) and m[1] in units else item
        for item in (*rest, *letters)
    ]
    lines = [*(f"{left} = {law}" for left, law in laws), *rest]
    return effect_from_text(f"{name}: {'; '.join(lines)}", where)


def effect_to_line(effect: Effect) -> str:
    """Return laws and coefficients of an effect in one line, without its name, as `typed_effect` reads them.

    What a line cannot hold is left out: usual sizes and bounds of amplitudes, and all that is said in words.
    """
    mapping = effect_to_mapping(effect)
    laws = [f"{target} = {mapping[target]}" for target in TARGETS if target in mapping]
    shapes = {
        c.name: f" = {c.shape:.6g} +- {c.shape_uncertainty:.3g}"
        for c in effect.coefficients
        if c.shape is not None
    }
    return "; ".join([*laws, *(f"{c.name}{shapes.get(c.name, '')} [{c.unit}]" for c in effect.coefficients)])


def _parts(text: str) -> list[str]:
    return [part for part in (" ".join(part.split()) for part in text.split(";")) if part]


def _known_target(target: str, where: str) -> str:
    if target not in LAW_FIELDS:
        raise InputError(f"{where}: target '{target[:60]}' is not known; allowed: {', '.join(TARGETS)}")
    return LAW_FIELDS[target]


def _item(text: str, target: str, *, first: bool) -> str:
    """Return a part of the line as `effect_from_text` has it; the first may be a law without a target."""
    left, equals, right = (part.strip() for part in text.partition("="))
    if not equals:
        return f"{target} = {text}" if first else text
    return f"{LAW_FIELDS.get(left, left)} = {right}"


def _letters(laws: Sequence[str]) -> list[str]:
    """Return the names of one letter in formulas that mean nothing yet, in order."""
    names = [match[1] or "" for law in laws for match in _WORD.finditer(_RAISED.sub("^n", law))]
    return list(dict.fromkeys(n for n in names if _LETTER.fullmatch(n) and n not in RESERVED))


def _units(
    laws: Sequence[tuple[str, str]], wanted: Sequence[str], units: Mapping[str, str]
) -> dict[str, str]:
    """Return the units of coefficients that follow from those of the targets and of the other coefficients.

    One is looked at after the other: those not known yet are zero, which ends the terms that have them, and some of
    them one where that leaves nothing or divides by it.
    """
    found: dict[str, str] = {}
    if len(wanted) > _MOST_INFERRED:
        return found
    for name in wanted:
        unit = _unit(laws, name, dict.fromkeys((n for n in wanted if n != name), "0"), units)
        found |= {name: unit} if unit else {}
    for name in wanted:
        others = [n for n in wanted if n not in (name, *found)]
        choices = sorted(itertools.product("01", repeat=len(others)), key=lambda choice: choice.count("1"))
        for choice in choices if name not in found else ():
            unit = _unit(laws, name, dict(zip(others, choice, strict=True)), {**units, **found})
            if unit:
                found[name] = unit
                break
    return found


def _unit(
    laws: Sequence[tuple[str, str]], name: str, others: Mapping[str, str], units: Mapping[str, str]
) -> str | None:
    """Return the unit of one coefficient, numbers standing in for `others`; None if it does not follow."""
    for target, law in laws:
        law = _RAISED.sub("^n", law)  # its unit is the same for any such exponent
        alone = _WORD.sub(lambda m: others.get(m[1] or "", m[0]), law)
        # whatever is wrong is said when the whole is read
        with contextlib.suppress(InputError):
            try:
                check_unit(read(alone, [name, *units]), {**units, name: None}, TARGETS[target].unit)
            except MissingUnitError as error:
                return str(Unit.of(str(error.unit)))
    return None
