"""What a proposed form says: where its torque acts, and with which powers of tilt and speed."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from gyrowheel.show.quantities import decimal, pair, with_error

if TYPE_CHECKING:
    from gyrowheel_analysis.diagnosis.result import FreeForm

_EXPONENT = re.compile(r"\^([kq])\b")


def form_sentence(form: FreeForm) -> str:
    """Return what a form says with what was found: exponents as numbers, edges in degrees, speeds in rpm."""
    found = form.coefficients

    def exponent(match: re.Match[str]) -> str:
        name = match[1]
        return f"^{decimal(found[name].value, 2)}" if name in found else match[0]

    text = _EXPONENT.sub(exponent, form.description)
    at = {name: place_text(form, name) for name in form.places}
    text = text.replace("beyond an edge", f"beyond {at.get('p', 'an edge')}")
    if "w" in at:
        text = text.replace("near one speed", f"near {at['p']}, within {at['w']} to either side")
    if "s" in found:
        text += f" (time constant {with_error(found['s'].value, found['s'].standard_error, 's')})"
    return text


def simple_sentence(form: FreeForm) -> str:
    """Return in a sentence that a form is a simple law within the errors of its exponents; empty where it is none."""
    if not form.simple:
        return ""
    found = ", ".join(
        f"{name} = {number} ({pair(form.coefficients[name].value, form.coefficients[name].standard_error)})"
        for name, number in form.whole.items()
    )
    return (
        f"The exponents are whole numbers within their errors, {found}: it may as well be the simple law below, which "
        "`gyrowheel model add` takes in place of the other."
    )


def place_text(form: FreeForm, name: str) -> str:
    """Return an edge, a centre or a width in the unit in which people read it."""
    place = form.places[name]
    return with_error(place.value, place.standard_error, place.unit)
