"""Code of the laws: generated source for the compiled simulation, array functions for the analysis."""

from __future__ import annotations

import functools
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy as sp
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.pycode import PythonCodePrinter

from gyrowheel_core import cache
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.complex_parts import components, split
from gyrowheel_sim.effects.declaration import Effect, EffectValues
from gyrowheel_sim.effects.quantities import REFERENCES
from gyrowheel_sim.effects.targets import HELD_OUTPUTS, TARGETS, Entry, LawTarget, Place, entering
from gyrowheel_sim.effects.torque_map import TorqueMap
from gyrowheel_sim.instruments import Reading

# --- kernel ---


#: The quantities of `gyrowheel_sim.effects.quantities` at an instant, complex ones by their components [SI].
Instant = namedtuple(
    "Instant",
    "zx zy zx_rate zy_rate theta_z Omega theta_x theta_y theta_x_rate theta_y_rate "
    "T_coil T_air T_winding T_motor rho i_motor Vx Vy t up up_x up_y home_xx home_xy home_yx home_yy",
)
#: What all laws together do to the motion, besides changes of bench parameters: torques on the rotor across its spin
#: axis (case axes) and along it, on the motor shaft, of the flexures [N m]; rate of the case [rad/s]; mirrored part of
#: the coils' torque.
Action = namedtuple(
    "Action", "across_x across_y along shaft flexure_x flexure_y case_rate_x case_rate_y mirror_x mirror_y"
)

# --- end of kernel ---

#: The generated functions that evaluate laws, with the targets of each; the second one is called once a sample.
FUNCTIONS: dict[str, tuple[LawTarget, ...]] = {
    "evaluate_laws": tuple(target for target in TARGETS.values() if not target.once_a_sample),
    "evaluate_samples": tuple(target for target in TARGETS.values() if target.once_a_sample),
}
#: The generated functions that write into the states of effects.
_STATES = ("law_rates", "law_starts")


class _Printer(PythonCodePrinter):
    """Python source for scalar compiled code: small powers as products, functions of `math`.

    `names` has what stands for a symbol.
    """

    names: Mapping[str, str] = MappingProxyType({})

    def _print_Symbol(self, expr: sp.Symbol) -> str:
        return self.names.get(expr.name, expr.name)

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
        base, exponent = expr.as_base_exp()
        if base.is_Symbol and exponent.is_Integer and 2 <= int(exponent) <= 4:
            return "(" + "*".join([self._print(base)] * int(exponent)) + ")"
        return str(super()._print_Pow(expr, rational=rational))

    def _print_sign(self, expr: sp.sign) -> str:
        return f"math.copysign(1.0, {self._print(expr.args[0])})"


class _ArrayPrinter(NumPyPrinter):
    """Python source for arrays: whole powers as products, since NumPy raises negative numbers 70 times as slowly."""

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
        base, exponent = expr.as_base_exp()
        if exponent.is_Integer and (int(exponent) > 2 or int(exponent) < -1):
            return f"{whole_power.__name__}({self._print(base)}, {int(exponent)})"
        return str(super()._print_Pow(expr, rational=rational))


def whole_power(base: Any, exponent: int) -> Any:
    """Return a whole power, not the zeroth, of numbers by products."""
    if exponent < 0:
        return 1.0 / whole_power(base, -exponent)
    if exponent == 1:
        return base
    root = whole_power(base, exponent // 2)
    return root * root * base if exponent % 2 else root * root


def coefficient_layout(effects: Sequence[Effect]) -> dict[tuple[str, str], int]:
    """Return the place of each (effect, coefficient) in the flat array of the compiled step, after the references."""
    keys = [(effect.name, c.name) for effect in effects for c in effect.coefficients]
    return {key: index for index, key in enumerate(keys, len(REFERENCES))}


def coefficient_arrays(
    effects: Sequence[Effect], values: EffectValues, bench: Bench
) -> tuple[np.ndarray, np.ndarray]:
    """Return (coefficients, active flags) for the compiled step; the reference values precede the coefficients."""
    layout = coefficient_layout(effects)
    coefficients = np.zeros(len(REFERENCES) + len(layout))
    active = np.zeros(len(effects), dtype=np.uint8)
    for index, effect in enumerate(effects):
        if effect.name in values:
            active[index] = 1
            for name, value in (effect.defaults() | values[effect.name]).items():
                coefficients[layout[effect.name, name]] = value
    for place, parameter in enumerate(REFERENCES.values()):
        coefficients[place] = bench.value(parameter)
    return coefficients, active


# --- the laws of effects


def memory_layout(effects: Sequence[Effect]) -> dict[tuple[str, str], range]:
    """Return the places of each (effect, state) among all states: two of a complex one, or of one of each flexure."""
    result, place = {}, 0
    for effect in effects:
        for state in effect.states:
            count = 2 if state.complex or effect.each_flexure else 1
            result[effect.name, state.name] = range(place, place + count)
            place += count
    return result


def memory_size(effects: Sequence[Effect]) -> int:
    """Return the numbers in the state of the plant that the states of effects need: see `memory_source`."""
    return 3 * sum(map(len, memory_layout(effects).values())) + 1


def laws_source(effects: Sequence[Effect], memory_start: int = 0) -> str:
    """Return the source of the functions that evaluate the laws of these effects; see `effects.generated`.

    `memory_start` is where in the state of the plant the states of the effects begin.
    """
    functions = [_function_source(effects, name, memory_start) for name in FUNCTIONS]
    return "\n\n".join([*functions, memory_source(effects, memory_start)])


def further_source(effects: Sequence[Effect], first: int, memory_start: int) -> str:
    """Return the source of the functions by which effects join a plant that was compiled without them.

    Those of `evaluate_laws`, `evaluate_samples`, `law_rates`, `law_starts` that they need, each called by address
    (`gyrowheel_sim.jit.call_laws`).

    Parameters
    ----------
    effects : sequence of Effect
        All effects of the plant, which make the layout of its arrays.
    first : int
        Those from this one on are not compiled in the plant.
    memory_start : int
        Where in the state of the plant the states of the effects begin.
    """
    own = effects[first:]
    used = {law.target for effect in own for law in effect.laws}
    functions = [
        _function_source(effects, name, memory_start, first)
        for name, targets in FUNCTIONS.items()
        if any(target.name in used for target in targets)
    ]
    states = [
        _states_source(effects, name, memory_start, first)
        for name in _STATES
        if any(effect.states for effect in own)
    ]
    return "\n\n".join([*functions, *states])


def memory_source(effects: Sequence[Effect], memory_start: int = 0) -> str:
    """Return the source of the functions for the states of these effects; see `effects.generated`.

    The state of the plant has the value of every state, its rate, its value in the middle of the sample, and one number
    that says whether they have begun.
    """
    indices = [str(k) for k, effect in enumerate(effects) if effect.states]
    anything = " or ".join(f"active[{k}] != 0" for k in indices) or "False"
    turning = " or ".join(f"active[{k}] != 0" for k in indices if effects[int(k)].each_flexure) or "False"
    return "\n\n".join(
        [
            f"LAW_MEMORY = {memory_start}\n",
            _inlined("law_states", "state", [f"return (len(state) - {memory_start + 1}) // 3"]),
            _inlined("remembers", "active", [f"return {anything}"]),
            _inlined("flexures_remember", "active", [f"return {turning}"]),
            *(_states_source(effects, name, memory_start) for name in _STATES),
        ]
    )


def states_source(effect: Effect) -> str:
    """Return the source of `law_rates` and `law_starts` of one effect, each called by address, see `further_source`."""
    return "\n\n".join(_states_source([effect], name, 0, 0) for name in _STATES)


def _states_source(
    effects: Sequence[Effect], function: str, memory_start: int, first: int | None = None
) -> str:
    """Return the source of a function that writes rates or start values of the states into the state."""
    printer, memory = _Printer({"fully_qualified_modules": True}), memory_layout(effects)
    lines = _head(function, first)
    out = str(memory_start)
    if function == "law_rates":  # they follow the states, those of effects that are not compiled here too
        out = "rates"
        count = sum(map(len, memory.values()))
        lines.append(
            "    rates = "
            + (f"{memory_start} + law_states(state)" if first is None else str(memory_start + count))
        )
    for index, effect in enumerate(effects[first or 0 :], first or 0):
        if not effect.states:
            continue
        lines.append(f"    if active[{index}]:  # {effect.name}")
        for number, state in enumerate(effect.states):
            places = memory[effect.name, state.name]
            outputs = [f"state[{out} + {place}]" for place in places]
            parts = split(state.rate if function == "law_rates" else state.start)
            sides = "xy" if effect.each_flexure else " "
            for side, output in zip(sides, outputs if effect.each_flexure else [""], strict=True):
                printer.names = _names(effects, effect, memory_start, side.strip())
                own = (output,) if output else tuple(outputs)
                prefix = f"_r{index}_{number}{side.strip()}"
                lines += _assignments(own, parts[: len(own)], printer, prefix, sets=True)
    return "\n".join([*lines, "    return"]) + "\n"


def _head(function: str, first: int | None) -> list[str]:
    """Return the lines that begin a function of laws: its name, the reference values, the quantities of an instant.

    With `first`, the function is called by address: it has pointers for arrays, and none for the fields of `q`.
    """
    inside = first is None
    return [
        "@register_jitable(forceinline=True)" if inside else "@called_by_address",
        f"def {function}(coef, active, state, q{'' if inside else ', sums'}):",
        *(f"    {name} = coef[{i}]" for i, name in enumerate(REFERENCES)),
        *(f"    {name} = q{f'.{name}' if inside else f'[{i}]'}" for i, name in enumerate(Instant._fields)),
    ]


def _names(effects: Sequence[Effect], effect: Effect, memory_start: int, side: str) -> dict[str, str]:
    """Return what stands in the source for coefficients and states of an effect, on one `side` for a flexure's law."""
    layout, memory = coefficient_layout(effects), memory_layout(effects)
    names = {c.name: f"coef[{layout[effect.name, c.name]}]" for c in effect.coefficients}
    for state in effect.states:
        places = [f"state[{memory_start + place}]" for place in memory[effect.name, state.name]]
        if side:
            names[state.name] = places["xy".index(side)]
        else:
            names |= zip((part.name for part in components(state.symbol)), places, strict=True)
    if side:
        names |= {
            "theta": f"theta_{side}",
            "theta_rate": f"theta_{side}_rate",
            "axis": "1.0" if side == "x" else "-1.0",
        }
    return names


@functools.cache
def cached_laws_source(effects: tuple[Effect, ...], memory_start: int, first: int | None = None) -> str:
    """Return `laws_source`, or with `first` `further_source`, kept on disk by the text of the declarations.

    SymPy takes seconds to make it, reading takes none.
    """
    folder = resources.files("gyrowheel_sim").joinpath("effects")
    own = [
        folder.joinpath(f"{name}.py").read_text(encoding="utf-8")
        for name in ("law_code", "complex_parts", "targets")
    ]
    declared = [
        (
            e.name,
            [(law.target, sp.srepr(law.expression)) for law in e.laws],
            [c.name for c in e.coefficients],
            [(s.name, sp.srepr(s.rate), sp.srepr(s.start), s.complex) for s in e.states],
        )
        for e in effects
    ]
    name = f"laws_{cache.digest(*own, repr(declared), str(memory_start), str(first), sp.__version__)}"
    if (kept := cache.read(name)) is not None:
        return kept.decode()
    text = (
        laws_source(effects, memory_start) if first is None else further_source(effects, first, memory_start)
    )
    cache.write(name, text.encode())
    return text


def _function_source(
    effects: Sequence[Effect], function: str, memory_start: int, first: int | None = None
) -> str:
    printer = _Printer({"fully_qualified_modules": True})
    targets = {target.name: target for target in FUNCTIONS[function]}
    outputs = [name for target in targets.values() for name in target.outputs]
    result = _tuple_name(function)
    if first is None:
        lines = [_tuple_source(result, outputs), "", *_head(function, None)]
        lines.append(f"    {' = '.join(outputs)} = 0.0")
    else:
        lines = _head(function, first)
        lines += [f"    {output} = sums[{place}]" for place, output in enumerate(outputs)]
    for index, effect in enumerate(effects[first or 0 :], first or 0):
        own = [(number, law) for number, law in enumerate(effect.laws) if law.target in targets]
        if not own:
            continue
        lines.append(f"    if active[{index}]:  # {effect.name}")
        for number, law in own:
            parts, target = split(law.expression), targets[law.target]
            if not target.each_flexure:
                printer.names = _names(effects, effect, memory_start, "")
                lines += _assignments(target.outputs, parts, printer, f"_v{index}_{number}_")
                continue
            # written once for both, by the angle of each
            for side, output in zip("xy", target.outputs, strict=True):
                printer.names = _names(effects, effect, memory_start, side)
                lines += _assignments((output,), parts[:1], printer, f"_v{index}_{number}{side}")
    if first is None:
        lines.append(f"    return {result}({', '.join(outputs)})")
    else:
        lines += [f"    sums[{place}] = {output}" for place, output in enumerate(outputs)]
    return "\n".join(lines) + "\n"


def _tuple_name(function: str) -> str:
    return "".join(word.capitalize() for word in function.split("_"))


def _tuple_source(name: str, fields: Sequence[str]) -> str:
    return "\n".join([f"class {name}(NamedTuple):", *(f"    {field}: float" for field in fields)]) + "\n"


def _assignments(
    outputs: Sequence[str], parts: Sequence[sp.Expr], printer: _Printer, prefix: str, *, sets: bool = False
) -> list[str]:
    """Return the lines that add `parts` to `outputs`, or set them, with common subexpressions computed once."""
    wanted = list(zip(outputs, parts, strict=False))
    shared, results = sp.cse([part for _, part in wanted], symbols=sp.numbered_symbols(prefix, real=True))
    lines = [f"        {symbol.name} = {printer.doprint(value)}" for symbol, value in shared]
    return lines + [
        f"        {output} {'=' if sets else '+='} {printer.doprint(result)}"
        for (output, _), result in zip(wanted, results, strict=True)
        if sets or result != 0
    ]


# --- where the laws enter the plant


def entries_source(parameters: Sequence[str], held_start: int) -> str:
    """Return the source of the functions through which the laws act in the plant; see `effects.generated`.

    `parameters`: names of the bench parameters that the kernel knows, in order; `held_start`: where in the
    state the outputs begin that are held from sample to sample.
    """
    held = {name: f"state[{held_start + index}]" for index, name in enumerate(HELD_OUTPUTS)}
    sampled = {name: f"laws.{name}" for name in HELD_OUTPUTS}
    at_instant = {n: f"laws.{n}" for target in TARGETS.values() for n in target.outputs if n not in held}
    action: dict[Place, tuple[str, ...]] = {
        "across": ("across_x", "across_y"), "along": ("along",), "shaft": ("shaft",),
        "flexure": ("flexure_x", "flexure_y"), "case_rate": ("case_rate_x", "case_rate_y"),
        "mirror": ("mirror_x", "mirror_y"),
    }  # fmt: skip
    done = {
        field: _total(place, "", part, at_instant)
        for place, fields in action.items()
        for part, field in enumerate(fields)
    }
    errors = {
        reading.name: _total("reading", reading.name, 0, sampled)
        if reading not in (Reading.tilt_x, Reading.tilt_y)
        else _total(
            "reading",
            "tilt",
            int(reading is Reading.tilt_y),
            sampled,
            _total("reading", reading.name, 0, sampled),
        )
        for reading in Reading
    }
    parts = [
        _tuple_source("Parameters", parameters),
        _tuple_source("ReadingErrors", list(errors)),
        _inlined("hold_samples", "state, laws", [f"{place} = laws.{name}" for name, place in held.items()]),
        _inlined("acting", "laws", [_returned("Action", {field: done[field] for field in Action._fields})]),
        _inlined("changed", "p, laws, state", [_changes(parameters, at_instant | held)]),
        _inlined("changed_at_sample", "p, state", [_changes(parameters, held)]),
        _inlined("lag_of_coils", "state", [f"return {_total('coil_lag', '', 0, held)}"]),
        _inlined("reading_errors", "laws", [_returned("ReadingErrors", errors)]),
    ]
    return "\n\n".join(parts)


def _inlined(name: str, arguments: str, body: Sequence[str]) -> str:
    lines = ["@register_jitable(forceinline=True)", f"def {name}({arguments}):"]
    return "\n".join([*lines, *(f"    {line}" for line in body)]) + "\n"


def _returned(kind: str, values: Mapping[str, str]) -> str:
    return f"return {kind}({', '.join(values.values())})"


def _changes(parameters: Sequence[str], outputs: Mapping[str, str]) -> str:
    result = {}
    for name in parameters:
        value = _total("offset", name, 0, outputs, f"p.{name}")
        factor = _total("relative", name, 0, outputs, "1.0")
        value = f"({value})" if value != f"p.{name}" and factor != "1.0" else value
        result[name] = value if factor == "1.0" else f"{value} * ({factor})"
    return _returned("Parameters", result)


def _total(place: Place, of: str, part: int, outputs: Mapping[str, str], start: str = "0.0") -> str:
    """Return source for `start` plus the outputs of the laws at a place: the x (0) or y (1) part."""
    terms = []
    for target, entry in entering(place, of):
        if target.outputs[0] in outputs:
            terms.append(_term(entry, outputs[target.outputs[part]]))
    if terms and start == "0.0" and terms[0].startswith(" + "):
        return terms[0][3:] + "".join(terms[1:])
    return start + "".join(terms)


def _term(entry: Entry, output: str) -> str:
    over = f" / p.{entry.over}" if entry.over else ""
    return f" {'-' if entry.negative else '+'} {output}{over}"


# --- arrays


def array_law(effect: Effect, index: int) -> Callable[[Mapping[str, Any]], Any]:
    """Return law number `index` of an effect as a function of arrays.

    The function takes a mapping of the quantities of `QUANTITIES`, the coefficients and the states by name; all
    broadcast.
    """
    if isinstance(effect, TorqueMap):  # its many terms are quicker as arrays than as an expression
        return functools.partial(effect.law_at, index)
    return array_function(effect.laws[index].expression)


@functools.lru_cache(maxsize=4096)
def symbols_of(expression: sp.Expr) -> frozenset[sp.Symbol]:
    """Return the symbols of an expression; SymPy collects them every time."""
    return frozenset(expression.free_symbols)


@functools.lru_cache(maxsize=4096)
def array_function(expression: sp.Expr) -> Callable[[Mapping[str, Any]], Any]:
    """Return an expression as a function of arrays by the names of its symbols."""
    functions: dict[str, Any] = {"numpy": np, "functools": functools, whole_power.__name__: whole_power}
    exec(compile(_array_source(expression), "<law>", "exec"), functions)
    evaluate: Callable[[Mapping[str, Any]], Any] = functions["evaluate"]
    return evaluate


def _array_source(expression: sp.Expr) -> str:
    """Return the source of the function ``evaluate`` of an expression, kept on disk by the text of the expression."""
    name = f"array_{cache.digest(_own_text(), sp.srepr(expression), sp.__version__)}"
    if (kept := cache.read(name)) is not None:
        return kept.decode()
    names = {"conjugate": "numpy.conjugate"}
    printer = _ArrayPrinter({"fully_qualified_modules": True, "inline": True, "user_functions": names})
    # names that no coefficient has
    shared, (result,) = sp.cse([_with_sizes(expression)], symbols=sp.numbered_symbols("_s"))
    lines = [
        "def evaluate(_given):",
        *(
            f"    {printer.doprint(symbol)} = _given[{symbol.name!r}]"
            for symbol in sorted(expression.free_symbols, key=str)
        ),
        *(f"    {printer.doprint(symbol)} = {printer.doprint(value)}" for symbol, value in shared),
        f"    return {printer.doprint(result)}",
    ]
    text = "\n".join(lines) + "\n"
    cache.write(name, text.encode())
    return text


def _with_sizes(expression: sp.Expr) -> sp.Expr:
    """Return an expression with squares of sizes as such: real powers and roots are far quicker than complex ones."""

    def sized(product: sp.Expr) -> sp.Expr:
        powers = product.as_powers_dict()
        for z in sorted(product.free_symbols, key=str):
            both = min(powers.get(z, 0), powers.get(sp.conjugate(z), 0)) if not z.is_real else 0
            if both > 0:
                product *= sp.Abs(z) ** (2 * both) / (z * sp.conjugate(z)) ** both
        return product

    return expression.replace(lambda e: isinstance(e, sp.Mul), sized)


@functools.cache
def _own_text() -> str:
    return resources.files("gyrowheel_sim").joinpath("effects/law_code.py").read_text(encoding="utf-8")
