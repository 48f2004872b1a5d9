"""Generate the parts of docs that come from the code: effect pages and index, reference, tables, momentum pictures.

``make docs`` calls this. With ``--check`` nothing is written; outdated files are listed, and the exit code is then 1.
"""

from __future__ import annotations

import argparse
import io
import itertools
import json
import math
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import sympy as sp
from PIL import Image
from sympy.printing.latex import LatexPrinter

from gyrowheel.catalogue.api import reach
from gyrowheel.catalogue.page import check_page, possible_sizes, reach_page
from gyrowheel.catalogue.plan_check import check_text
from gyrowheel.momentum_envelope.picture import body_figure, caps_figure
from gyrowheel.show.figure import png_bytes
from gyrowheel.show.formulas import in_words, pretty
from gyrowheel.show.layout import plain_text
from gyrowheel.show.sentences.diagnosis import ERROR_TITLES
from gyrowheel_analysis.fitting.fit import ERRORS
from gyrowheel_control.plans.adaptation import plan_template
from gyrowheel_control.plans.plan import Block, PlanFile
from gyrowheel_core.errors import InputError
from gyrowheel_core.quantities import minus, quantity, span, with_error
from gyrowheel_core.schema import Section, keys
from gyrowheel_core.surroundings import VARIABLES
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects import Coefficient, Effect, registry
from gyrowheel_sim.effects.formula import factor_place, ordered_terms, signless_first
from gyrowheel_sim.effects.grammar import FUNCTIONS, HANDY
from gyrowheel_sim.effects.quantities import QUANTITIES, REFERENCES, z
from gyrowheel_sim.effects.targets import TARGETS
from gyrowheel_sim.effects.user_defined_line import typed_effect
from gyrowheel_sim.mechanics.kinematics import Envelope, envelope
from tools import house, licences, reference
from tools.effect_picture import to_svg
from tools.effect_signature import Signature, signature

#: Texts and pictures by path.
Pages: TypeAlias = dict[Path, str | bytes]
ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
_MADE = "<!-- Made by `make docs` from the declarations in the code; edit those. -->"
_CATEGORIES = {
    "air": "Air",
    "flexure": "Flexures",
    "bearing": "Bearing",
    "motor": "Motor",
    "actuator": "Coils and supply",
    "sensor": "Sensors",
    "instrument": "Instruments that are not as stated",
    "gravity": "Gravity and constant torques",
    "inertia": "Inertias",
    "environment": "Surroundings",
    "other": "Other",
}
_FUNCTIONS = {
    "conj": "complex conjugate",
    "abs": "absolute value; also `|x|`",
    "re": "real part",
    "im": "imaginary part",
    "sign": "sign, -1, 0 or 1",
    "sqrt": "square root",
    "exp": "exponential; of a complex number too",
    "log": "natural logarithm",
    "sin": "sine",
    "cos": "cosine",
    "tanh": "hyperbolic tangent",
    "max": "largest of two or more",
    "min": "smallest of two or more",
}
_HANDY = {"r": "spin rate over its reference, `Omega/Omega_ref`", "i": "imaginary unit", "pi": "π"}
#: Examples of refused formulas for the page.
_REFUSED = (
    "-k*Omgea*z",
    "-k*z*Omega; k [N*m]",
    "-k*z + c; k [N*m/rad]; c [N*m*s]",
    "-k*r^n*z",
    "coil_gain = g*z",
    "-k*z; k [mN*m/rad]",
    "k*log(0)",
    "-k*z*",
    "k*__import__('os')",
)
_REFUSED_STATES = (
    "-k*z; d(s)/dt = (z - s)/tau; tau = 5 +- 3 [s]",
    "-k*s; d(s)/dt = (z - q1)/tau; q1 [m]; tau = 5 +- 3 [s]",
    "-k*s; d(s)/dt = -s/tau; s(0) = z_ref; tau = 5 +- 3 [s]",
    "-k*s; d(s)/dt = (z + s)/tau; tau = 0.5 +- 0.1 [s]",
    "-k*s; d(s)/dt = (z - s)/tau; tau = 0.1e-3 +- 0.01e-3 [s]",
    "coil_gain = k*s; d(s)/dt = (z - s)/tau; tau = 5 +- 3 [s]",
    "tilt_delay = k*s; d(s)/dt = (|z| - s)/tau; tau = 5 +- 3 [s]",
)
#: What the error of a bench parameter does to the torques.
_ERROR_SIGNS = {
    "stiffness_error": "It adds a torque in proportion to the tilt and in phase with it, the same at every speed.",
    "gimbal_inertia_error": "It adds a torque in proportion to the tilt that grows with the square of the speed.",
    "shaft_inertia_error": "It adds a torque that grows with the cube of the tilt and the square of the speed.",
    "rotor_inertia_error": "It shows wherever the rotor is turned: in cones, slews and changes of the speed.",
    "transverse_inertia_error": "It adds a torque twice a revolution, by the tilt and the square of the speed.",
    "coil_gain_error": "It changes all torques of the coils by one factor.",
    "motor_constant_error": "It changes the torque of the motor and its back-EMF by one factor.",
    "motor_resistance_error": "It adds a voltage of the motor in proportion to its current.",
}
#: Tolerance for the numbers of a picture: libraries round differently.
_TOLERANCE = 2e-3

# --- formulas ---


class _Latex(LatexPrinter):
    """LaTeX printer with the usual order of factors: i, coefficients, other factors, tilt."""

    def _print_Mul(self, expr: sp.Mul) -> str:
        number, rest = expr.as_coeff_Mul()
        factors = sorted(sp.Mul.make_args(rest), key=factor_place)
        over = [f for f in factors if not _divides(f)]
        under = [sp.Pow(f.base, -f.exp) for f in factors if _divides(f)]
        over += [] if abs(number.p) == 1 and over else [sp.Integer(abs(number.p))]
        over.sort(key=lambda f: not f.is_Number)
        if number.q != 1:
            under.insert(0, sp.Integer(number.q))
        sign = "- " if number.is_negative else ""
        if not under:
            return sign + self._joined(over)
        # the tilt follows the fraction
        last = [f for f in over if z in f.free_symbols] if len(over) > 1 else []
        top = self._joined([f for f in over if f not in last]) or "1"
        return rf"{sign}\frac{{{top}}}{{{self._joined(under)}}} {self._joined(last)}".rstrip()

    def _joined(self, factors: Sequence[sp.Expr]) -> str:
        texts = [self._factor(f) for f in factors]
        # a name of several letters needs a space
        spaced = [rf"\, {t}" if "mathrm" in a + t else t for a, t in itertools.pairwise(texts)]
        return " ".join([*texts[:1], *spaced])

    def _print_Add(self, expr: sp.Add, order: str | None = None) -> str:
        texts = signless_first(self._print(term) for term in ordered_terms(expr))
        return texts[0] + "".join(
            f" - {t[1:].lstrip()}" if t.startswith("-") else f" + {t}" for t in texts[1:]
        )

    def _factor(self, factor: sp.Expr) -> str:
        text = self._print(factor)
        return rf"\left({text}\right)" if factor.is_Add else text

    def _print_Abs(self, expr: sp.Abs, exp: str | None = None) -> str:
        return rf"\left|{self._print(expr.args[0])}\right|" + (f"^{{{exp}}}" if exp else "")

    def _print_conjugate(self, expr: sp.conjugate, exp: str | None = None) -> str:
        return rf"\bar{{{self._print(expr.args[0])}}}" + (f"^{{{exp}}}" if exp else "")

    def _print_Symbol(self, expr: sp.Symbol, style: str = "plain") -> str:
        return _symbol(expr.name)


def _divides(factor: sp.Expr) -> bool:
    return isinstance(factor, sp.Pow) and bool(factor.exp.is_number) and bool(factor.exp.is_negative)


def _symbol(name: str) -> str:
    if name == "|z|":
        return name
    if name.endswith("_rate"):
        return rf"\dot{{{_symbol(name.removesuffix('_rate'))}}}"
    base, _, index = name.partition("_")
    greek = sp.latex(sp.Symbol(base))
    base = greek if greek.startswith("\\") or len(base) == 1 else rf"\mathrm{{{base}}}"
    if index == "ref":
        return f"{base}_0"
    if len(index) > 1:
        index = rf"\mathrm{{{index}}}".replace("_", r"\_")
    return f"{base}_{{{index}}}" if index else base


def latex(expression: sp.Expr) -> str:
    """Return an expression in LaTeX, `|z|²` for the product of the tilt with its conjugate."""
    size = sp.Symbol("|z|", positive=True)
    text = _Latex().doprint(expression.subs(z * sp.conjugate(z), size**2))
    return re.sub(r"\\sqrt\{\|z\|\^\{2\}\}", "|z|", text)


# --- pages of the effects ---


def effect_page(effect: Effect, picture: Signature | None, bench: Bench) -> str:
    """Return the page of an effect."""
    return "\n".join(_effect_lines(effect, picture, bench)) + "\n"


def _effect_lines(effect: Effect, picture: Signature | None, bench: Bench) -> Iterator[str]:
    yield f"# {effect.name}"
    yield f"\n{_MADE}\n"
    yield f"**{_upper(effect.title)}.** {effect.sentence}"
    yield "\n## Law\n"
    typed = iter(effect.formula.split("; "))
    for law in effect.laws:
        yield f"{_upper(in_words(law.target))}:\n"
        yield f"$${latex(law.expression)}$$\n"
        yield f"Typed: `{next(typed)}`\n"
    for state in effect.states:
        start = f" It is ${latex(state.start)}$ at the first sample." if state.start != 0 else ""
        own = " of each flexure" if effect.each_flexure else ""
        yield f"The law remembers ${_symbol(state.name)}${own} [{_unit(state.unit)}], which changes by\n"
        yield f"$$\\frac{{d {_symbol(state.name)}}}{{dt}} = {latex(state.rate)}$$\n"
        yield f"Typed: `{'; '.join(itertools.islice(typed, 1 + (state.start != 0)))}`.{start}\n"
    yield f"It acts on {_and(_acts_on(effect))}.\n"
    yield "| symbol | typed | unit | meaning |"
    yield "|---|---|---|---|"
    every = [law.expression for law in effect.laws] + [e for s in effect.states for e in (s.rate, s.start)]
    used = {s.name for expression in every for s in expression.free_symbols}
    for name, known in QUANTITIES.items():
        if name in used:
            yield f"| ${_symbol(name)}$ | `{name}` | {_unit(known.unit)} | {_cell(known.description)} |"
    for c in effect.coefficients:
        yield f"| ${_symbol(c.name)}$ | `{c.name}` | {_unit(c.unit)} | {_cell(c.description)} |"
    yield "\n## Coefficients\n"
    yield "| | usual size | allowed | prior | source |"
    yield "|---|---|---|---|---|"
    for c in effect.coefficients:
        yield f"| `{c.name}` | {_usual(c)} | {_span(c, c.bounds)} | {_prior(c)} | {_cell(c.source)} |"
    for text in possible_sizes(effect):
        yield f"\nPossible: {minus(text)}."
    yield "\n## Signature\n"
    yield from _picture_lines(effect, picture, bench)
    yield "\n## Validity\n"
    yield f"{_upper(effect.validity)}. Source: {effect.source}."
    if effect.look_alikes:
        yield "\n## Confounders\n"
        yield "| effect | separated by |"
        yield "|---|---|"
        for name, test in effect.look_alikes.items():
            yield f"| {_linked(name)} | {_cell(test)} |"
    yield "\n## Example\n"
    yield "```"
    yield f"gyrowheel simulate --plan quick -o runs/{effect.name} --effect {effect.name}"
    yield "```"
    yield "\n[All effects](README.md)"


def error_page(name: str, bench: Bench) -> str:
    """Return the page of the error of a bench parameter."""
    groups = bench.groups()
    own = [p for group in ERRORS[name] for p in groups[group]]
    lines = [
        f"# {name}",
        f"\n{_MADE}\n",
        f"**{_upper(ERROR_TITLES[name])}.** {_ERROR_SIGNS[name]}",
        "\n## Parameters\n",
        "| parameter | on the default bench | meaning |",
        "|---|---|---|",
        *(
            f"| `{p.name}` | {with_error(p.value, p.uncertainty, p.unit)} | {_cell(p.description)} |"
            for p in own
        ),
        "\nEvery fit estimates these parameters within their stated uncertainties, and lists those that moved. Beyond",
        "five of its stated uncertainties a parameter is a finding with this name, and from three on it is named as an",
        "alternative. Its coefficient, `relative_error`, is the relative deviation from the stated value.",
    ]
    alike = {
        effect.name: effect.look_alikes[name] for effect in registry().values() if name in effect.look_alikes
    }
    if alike:
        lines += ["\n## Confounders\n", "| effect | separated by |", "|---|---|"]
        lines += [f"| {_linked(effect)} | {_cell(test)} |" for effect, test in alike.items()]
    lines += [
        "\n## Example\n",
        "```",
        f"gyrowheel model add {name} --model wheel.yaml --fit runs/quick",
        "```",
        "\n[All effects](README.md)",
    ]
    return "\n".join(lines) + "\n"


def _acts_on(effect: Effect) -> list[str]:
    return [
        f"`{target}` ({TARGETS[target].sentence}, in {_unit(TARGETS[target].unit)})"
        for target in dict.fromkeys(law.target for law in effect.laws)
    ]


def _picture_lines(effect: Effect, found: Signature | None, bench: Bench) -> Iterator[str]:
    if effect.states:
        yield "It depends on what was before; no tilt and speed alone show it. [A law with a memory](../memory.md)."
        return
    if found is None:
        yield "At its usual size on the default bench it is not visible at a constant or slowly turning tilt."
        return
    yield f"![additional torque of coils and motor]({effect.name}.svg)\n"
    rpm, tilt = found.speed_held / RPM, bench.value("tilt_limit") / DEG
    values = ", ".join(
        f"{c.name} = {quantity(c.default, c.unit, pure=c.shape is not None)}" for c in effect.coefficients
    )
    state = f" {found.state}" if found.state else ""
    yield (
        f"Additional torque of coils and motor of the default bench at a constant tilt, with {values}. "
        f"Left: torque of the coils at tilts of up to {tilt:.0f}° in every direction, at {rpm:.0f} rpm.{state}"
    )


def index_page(effects: Sequence[Effect]) -> str:
    """Return the index of the effects."""
    lines = [
        "# Effects",
        f"\n{_MADE}\n",
        "Each is declared once, in `gyrowheel_sim/effects`; simulation, regressors, formulas, help and these pages",
        "come from that declaration. [How to declare an effect](../formulas.md).",
    ]
    for category, title in _CATEGORIES.items():
        own = [effect for effect in effects if effect.category == category]
        if own:
            lines += [f"\n## {title}\n", "| effect | what it is | law |", "|---|---|---|"]
            for effect in own:
                law = "<br>".join(_cell(part) for part in pretty(effect.formula).split("; "))
                lines.append(f"| {_linked(effect.name)} | {_cell(effect.title)} | {law} |")
    lines += [
        "\n## Errors of the bench file\n",
        "A bench parameter beyond five of its stated uncertainties is a finding with one of these names:\n",
        "| name | parameters |",
        "|---|---|",
        *(
            f"| {_linked(name)} | {', '.join(f'`{group}`' for group in groups)} |"
            for name, groups in ERRORS.items()
        ),
    ]
    return "\n".join(lines) + "\n"


def _usual(c: Coefficient) -> str:
    return f"{_span(c, c.usual)}{', either sign' if c.signed else ''}"


def _span(c: Coefficient, values: tuple[float, float]) -> str:
    return span(*values, c.unit, pure=c.shape is not None)


def _prior(c: Coefficient) -> str:
    if c.shape is None:
        return "none"
    return f"{quantity(c.shape, c.unit, pure=True)} ± {quantity(c.shape_uncertainty, c.unit, pure=True)}"


def _linked(name: str) -> str:
    return f"[{name}]({name}.md)" if name in registry() or name in ERRORS else f"`{name}`"


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _and(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _unit(unit: str) -> str:
    return unit.replace("*", "·").replace("^2", "²").replace("^3", "³")


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


# --- tables of docs/formulas.md ---


def tables() -> dict[str, str]:
    """Return the generated tables by name."""
    quantities = ["| name | unit | meaning |", "|---|---|---|"]
    quantities += [
        f"| `{n}` | {_unit(q.unit)} | {_cell(q.description)}{_reference(n)} |" for n, q in QUANTITIES.items()
    ]
    quantities += [f"| `{name}` | 1 | {_HANDY[name]} |" for name in HANDY]
    targets = ["| target | unit | real or complex | meaning |", "|---|---|---|---|"]
    targets += [
        f"| `{t.name}` | {_unit(t.unit)} | {'complex' if t.complex else 'real'} | {_cell(t.sentence)} |"
        for t in TARGETS.values()
    ]
    functions = ["| function | meaning |", "|---|---|"]
    functions += [f"| `{name}` | {_cell(_FUNCTIONS[name])} |" for name in FUNCTIONS]
    refused = ["| typed | answer |", "|---|---|"]
    refused += [f"| `{_cell(text)}` | {_cell(_refusal(text))} |" for text in _REFUSED]
    states = refused[:2] + [f"| `{_cell(text)}` | {_cell(_refusal(text))} |" for text in _REFUSED_STATES]
    named = {"quantities": quantities, "targets": targets, "functions": functions, "refused": refused}
    named["refused states"] = states
    named |= {"benches": _bench_table()} | _momentum_tables() | _plan_tables() | {"reach": _reach()}
    named |= {"further pages": _further(), "environment": _environment()}
    return {name: "\n".join(lines) for name, lines in named.items()}


_BENCH_ROWS = (
    "rotor_inertia_z",
    "rotor_inertia_x",
    "flexure_stiffness_x",
    "spin_rate_reference",
    "spin_rate_minimum",
    "spin_rate_maximum",
    "tilt_limit",
    "coil_constant",
    "motor_constant",
    "supply_voltage",
    "bearing_coulomb",
    "sample_period",
    "tilt_noise",
    "air_density_reference",
)


def _environment() -> list[str]:
    lines = ["| variable | what it does | allowed |", "|---|---|---|"]
    return [*lines, *(f"| `{own.name}` | {_cell(own.about)} | {_cell(own.allowed)} |" for own in VARIABLES)]


def _bench_table() -> list[str]:
    benches = [Bench.load(name) for name in Bench.shipped()]
    lines = [
        "| | " + " | ".join(f"`{bench.name}`" for bench in benches) + " |",
        "|---" * (len(benches) + 1) + "|",
    ]
    lines.append("| | " + " | ".join(bench.title for bench in benches) + " |")
    for name in _BENCH_ROWS:
        values = [quantity(bench.value(name), bench.parameters[name].unit, pure=True) for bench in benches]
        lines.append(f"| {benches[0].parameters[name].description} | {' | '.join(values)} |")
    return lines


_MISTAKES = """\
schema: 1
name: mine
hold: 1.5
segments:
  - {spin_rpm: 3500, tilt_degs: [[0, 0], [3, 0]]}
  - {spin_rpm: 9000, tilt_deg: [[0, 0]]}
  - {cone_radius_deg: 3}
  - {rig: sideways, hold_s: soon}
"""


def _reach() -> list[str]:
    bench = Bench.load()
    inertias = ("rotor_inertia_x", "rotor_inertia_y", "rotor_inertia_z")
    heavy = bench.with_values({name: 2.0 * bench.value(name) for name in inertias})
    return ["```", *plain_text(reach_page(reach(heavy))).strip().splitlines(), "```"]


def _plan_tables() -> dict[str, list[str]]:
    bench = Bench.load()
    tables = {
        "plan keys": _keys(PlanFile),
        "segment keys": _keys(Block),
    }
    for name, text in (("plan check", plan_template(bench, "mine")), ("plan mistakes", _MISTAKES)):
        shown = plain_text(check_page(check_text(text, "mine.yaml", bench)))
        tables[name] = ["```", *shown.splitlines(), "```"]
    tables["plan mistakes"] = ["```yaml", *_MISTAKES.splitlines(), "```", "", *tables["plan mistakes"]]
    return tables


def _keys(section: type[Section]) -> list[str]:
    lines = ["| key | unit | allowed | default | meaning |", "|---|---|---|---|---|"]
    for key in keys(section):
        default = "must be given" if key.required else f"`{key.default}`" if key.default else ""
        lines.append(f"| `{key.name}` | {key.unit} | {_cell(key.allowed)} | {default} | {_cell(key.about)} |")
    return lines


def _further() -> list[str]:
    """Return the list of the pages that are missing in the index."""
    index = (DOCS / "README.md").read_text(encoding="utf-8").partition("<!-- table: further pages -->")[0]
    listed = set(re.findall(r"\]\(([^)#]+)\)", index))
    pages = [path for path in sorted(DOCS.glob("*.md")) if path.name not in {*listed, "README.md"}]
    heads = [path.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ") for path in pages]
    rows = [f"- [{head}]({path.name})" for head, path in zip(heads, pages, strict=True)]
    return ["## Further", "", *rows] if rows else []


def _momentum_tables() -> dict[str, list[str]]:
    found = envelope(Bench.load())
    errors = ["| tilt | last form | middle expression |", "|---|---|---|"]
    errors += [
        f"| {tilt / DEG:.0f}° | {last:.2%} | {middle:.1%} |"
        for tilt, last, middle in zip(found.tilt, found.error_last, found.error_middle, strict=True)
        if tilt > 0.0
    ]
    limit = f"{found.tilt[-1] / DEG:.0f}°"
    sizes = [
        f"| speed | upright, N·m·s | at {limit}: along the case axis | across it | exact, within a revolution |",
        "|---|---|---|---|---|",
    ]
    for s, speed in enumerate(found.speed):
        upright, (x, y, along) = found.approximate[s, 0, 0, 2], found.approximate[s, -1, 0]
        sizes.append(
            f"| {speed / RPM:.0f} rpm | {upright:.4f} | {along:.4f} | {math.hypot(x, y):.4f} "
            f"| {found.smallest[s, -1, 0]:.4f} .. {found.largest[s, -1, 0]:.4f} |"
        )
    return {"momentum errors": errors, "momentum sizes": sizes}


def _refusal(text: str) -> str:
    try:
        typed_effect(text, name="own", where="--formula")
    except InputError as error:
        return str(error)
    raise ValueError(f"{text} is not refused")


def _reference(name: str) -> str:
    return f" (`{REFERENCES[name]}` of the bench file)" if name in REFERENCES else ""


def with_tables(text: str) -> str:
    """Return a page with its generated tables, each between a comment with its name and an end comment."""
    for name, table in tables().items():
        begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
        before, found, rest = text.partition(begin)
        if found:
            text = f"{before}{begin}{table}\n{end}{rest.partition(end)[2]}"
    return text


def momentum_numbers(d: Envelope) -> dict[str, Any]:
    """Return the numbers of the pictures of the momentum, to five digits, for one azimuth: all are alike."""

    def numbers(values: Any) -> Any:
        if np.ndim(values):
            return [numbers(value) for value in values]
        return 0.0 if abs(values) < 1e-12 else float(f"{values:.5g}")

    return {
        "speed_rad_s": numbers(d.speed),
        "tilt_rad": numbers(d.tilt),
        "along_axis": numbers(d.approximate[:, :, 0, 2]),
        "across_axis": numbers(np.hypot(d.approximate[:, :, 0, 0], d.approximate[:, :, 0, 1])),
        "smallest": numbers(d.smallest[:, :, 0]),
        "largest": numbers(d.largest[:, :, 0]),
        "error_last": numbers(d.error_last),
        "error_middle": numbers(d.error_middle),
    }


def momentum_csv(d: Envelope) -> str:
    """Return the momentum envelope as a table, one state a line, SI units."""
    lines = [
        "spin_rate,tilt,azimuth,h_x,h_y,h_z,exact_mean_x,exact_mean_y,exact_mean_z,exact_smallest,exact_largest"
    ]
    for s, t, a in np.ndindex(d.smallest.shape):
        if d.tilt[t] == 0.0 and a:
            continue  # all azimuths are one
        state = (d.speed[s], d.tilt[t], d.azimuth[a])
        values = (
            *state, *d.approximate[s, t, a], *d.exact_mean[s, t, a], d.smallest[s, t, a], d.largest[s, t, a],
        )  # fmt: skip
        lines.append(",".join(f"{0.0 if abs(v) < 1e-12 else v:.6g}" for v in values))
    return "\n".join(lines) + "\n"


# --- all of it ---


def made() -> Pages:
    """Return all generated files by path."""
    bench = Bench.load()
    pages: Pages = {}
    effects = list(registry().values())
    for effect in effects:
        found = signature(effect, bench)
        pages[DOCS / "effects" / f"{effect.name}.md"] = effect_page(effect, found, bench)
        if found is not None:
            pages[DOCS / "effects" / f"{effect.name}.svg"] = to_svg(found, json.dumps(found.to_json()))
    for name in ERRORS:
        pages[DOCS / "effects" / f"{name}.md"] = error_page(name, bench)
    pages[DOCS / "effects" / "README.md"] = index_page(effects)
    for page in (
        "README.md",
        "formulas.md",
        "memory.md",
        "momentum.md",
        "benches.md",
        "plans.md",
        "your_bench.md",
        "environment.md",
    ):
        pages[DOCS / page] = with_tables((DOCS / page).read_text(encoding="utf-8"))
    momentum = envelope(bench)
    pages[DOCS / "momentum.csv"] = momentum_csv(momentum)
    pages[DOCS / "licences.md"] = licences.page()
    pages |= {DOCS / "reference" / name: text for name, text in reference.pages().items()}
    pages[DOCS / "images" / "house.svg"] = house.to_svg()
    shown = json.dumps(momentum_numbers(momentum))
    pages[DOCS / "images" / "momentum_caps.png"] = png_bytes(caps_figure(bench), shown)
    pages[DOCS / "images" / "momentum_body.png"] = png_bytes(body_figure(bench), shown)
    return pages


def stale(pages: Pages) -> list[Path]:
    """Return the outdated files and the superfluous ones."""
    there = set((DOCS / "effects").glob("*"))
    wrong = [path for path, content in pages.items() if not _same(path, content)]
    return [*wrong, *sorted(there - set(pages))]


def _same(path: Path, content: str | bytes) -> bool:
    if not path.is_file():
        return False
    if isinstance(content, bytes):
        return _close(_numbers_of_png(path.read_bytes()), _numbers_of_png(content))
    old = path.read_text(encoding="utf-8")
    if path.suffix == ".csv":
        return _close(_table(old), _table(content))
    if path.suffix == ".svg" and _numbers(content) is not None:  # equal if it shows the same numbers
        return _close(_numbers(old), _numbers(content))
    return old == content


def _table(text: str) -> list[object]:
    head, *rows = text.splitlines()
    return [head, *([float(number) for number in row.split(",")] for row in rows)]


def _numbers_of_png(content: bytes) -> object:
    text = Image.open(io.BytesIO(content)).info.get("Description")
    return json.loads(text) if text else None


def _numbers(svg: str) -> object:
    found = re.search(r"<dc:description>(.*?)</dc:description>", svg, re.DOTALL)
    return json.loads(found[1]) if found else None


def _close(a: object, b: object) -> bool:
    if isinstance(a, dict) and isinstance(b, dict):
        return list(a) == list(b) and all(_close(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        size = max((abs(x) for x in (*a, *b) if isinstance(x, float)), default=0.0)
        return all(
            math.isclose(x, y, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE * size + 1e-9)
            if isinstance(x, float) and isinstance(y, float)
            else _close(x, y)
            for x, y in zip(a, b, strict=True)
        )
    return a == b


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pages, or check them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit with 1 if a page is not up to date"
    )
    check = parser.parse_args(arguments).check
    pages = made()
    wrong = stale(pages)
    for path in wrong:
        print(
            f"{'not up to date' if check else 'written' if path in pages else 'removed'}: {path.relative_to(ROOT)}"
        )
        if check:
            continue
        if path in pages:
            path.parent.mkdir(parents=True, exist_ok=True)
            content = pages[path]
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        else:
            path.unlink()
    if check and wrong:
        print("run `make docs`", file=sys.stderr)
    return int(check and bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
