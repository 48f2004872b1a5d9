"""From declarations to code: generated compiled source for the simulation, array functions for the analysis."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

import numba
import numpy as np
import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from gyrowheel_core.files import write_text
from gyrowheel_sim.bench import Bench
from gyrowheel_sim.effects.declaration import TARGETS, Effect
from gyrowheel_sim.effects.parts import split
from gyrowheel_sim.effects.quantities import QUANTITIES, REFERENCES
from gyrowheel_sim.effects.registry import EffectValues

#: The quantities that the kernel's array of the environment begins with, in order.
ENVIRONMENT = ("up", "up_x", "up_y", "home_xx", "home_xy", "home_yx", "home_yy")

_MARK = "# --- kernel ---"
_END = "# --- end of kernel ---"


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


def coefficient_layout(effects: Sequence[Effect]) -> dict[tuple[str, str], int]:
    """Return the place of each (effect, coefficient) in the flat array of the compiled step."""
    keys = [(effect.name, c.name) for effect in effects for c in effect.coefficients]
    return {key: index for index, key in enumerate(keys)}


def coefficient_arrays(
    effects: Sequence[Effect], values: EffectValues, bench: Bench
) -> tuple[np.ndarray, np.ndarray]:
    """Return (coefficients, active flags) for the compiled step; the reference values follow the coefficients."""
    layout = coefficient_layout(effects)
    coefficients = np.zeros(len(layout) + len(REFERENCES))
    active = np.zeros(len(effects), dtype=np.uint8)
    for index, effect in enumerate(effects):
        if effect.name in values:
            active[index] = 1
            for name, value in (effect.defaults() | values[effect.name]).items():
                coefficients[layout[effect.name, name]] = value
    for offset, parameter in enumerate(REFERENCES.values()):
        coefficients[len(layout) + offset] = bench.value(parameter)
    return coefficients, active


#: What the generated functions return, by target; the second one is called once a sample.
OUTPUTS: dict[str, dict[str, tuple[str, ...]]] = {
    "evaluate_laws": {
        "rotor_torque": ("Tx", "Ty"),
        "axial_torque": ("axial",),
        "shaft_torque": ("shaft",),
        "flexure_torque": ("flex_x", "flex_y"),
        "inertia_difference": ("difference",),
        "case_rate": ("turn_x", "turn_y"),
        "coil_gain": ("gain",),
        "coil_anisotropy": ("mirror_x", "mirror_y"),
        "motor_gain": ("motor",),
        "winding_resistance": ("resistance",),
    },
    "evaluate_samples": {
        "coil_lag": ("lag",),
        "supply_drop": ("drop",),
        "tilt_reading": ("read_x", "read_y"),
    },
}


def laws_source(effects: Sequence[Effect]) -> str:
    """Return the source of the two functions of `gyrowheel_sim.effects.no_laws` for these effects."""
    return "\n\n".join(_function_source(effects, name) for name in OUTPUTS)


def _function_source(effects: Sequence[Effect], function: str) -> str:
    printer = _Printer({"fully_qualified_modules": True})
    layout = coefficient_layout(effects)
    outputs = OUTPUTS[function]
    every = [name for names in outputs.values() for name in names]
    lines = [
        "@register_jitable(forceinline=True)",
        f"def {function}(coef, active, env, zx, zy, zx_rate, zy_rate, theta_z, Omega, theta_x, theta_y, theta_x_rate,",
        "                  theta_y_rate, T_coil, T_air, T_winding, T_motor, rho, i_motor, t):",
        *(f"    {name} = coef[{len(layout) + i}]" for i, name in enumerate(REFERENCES)),
        *(f"    {name} = env[{i}]" for i, name in enumerate(ENVIRONMENT)),
        f"    {' = '.join(every)} = 0.0",
    ]
    for index, effect in enumerate(effects):
        own = [(number, law) for number, law in enumerate(effect.laws) if law.target in outputs]
        if not own:
            continue
        lines.append(f"    if active[{index}]:  # {effect.name}")
        places = {c.name: f"coef[{layout[effect.name, c.name]}]" for c in effect.coefficients}
        for number, law in own:
            parts = split(law.expression)
            # a flexure's law is written once for both, by its own angle and rate
            for side in "xy" if law.target == "flexure_torque" else "":
                printer.names = places | {
                    "theta": f"theta_{side}",
                    "theta_rate": f"theta_{side}_rate",
                    "axis": "1.0" if side == "x" else "-1.0",
                }
                lines += _assignments((f"flex_{side}",), parts[:1], printer, f"_v{index}_{number}{side}")
            if law.target != "flexure_torque":
                printer.names = places
                lines += _assignments(outputs[law.target], parts, printer, f"_v{index}_{number}_")
    lines.append(f"    return {', '.join(every)}")
    return "\n".join(lines) + "\n"


def _assignments(
    outputs: Sequence[str], parts: Sequence[sp.Expr], printer: _Printer, prefix: str
) -> list[str]:
    """Return the lines that add `parts` to `outputs`; what occurs twice is computed once."""
    wanted = list(zip(outputs, parts, strict=False))
    shared, results = sp.cse([part for _, part in wanted], symbols=sp.numbered_symbols(prefix, real=True))
    lines = [f"        {symbol.name} = {printer.doprint(value)}" for symbol, value in shared]
    return lines + [
        f"        {output} += {printer.doprint(result)}"
        for (output, _), result in zip(wanted, results, strict=True)
        if result != 0
    ]


def compose(effects: Sequence[Effect], extra: Sequence[tuple[str, str]] = ()) -> ModuleType:
    """Return the compiled module of the plant with these effects; cached on disk by content.

    Parameters
    ----------
    effects : sequence of Effect
        Effects whose laws are compiled in; each acts only where its flag is set.
    extra : sequence of (package, file name)
        Further kernel files that are appended (a controller, a closed loop); the text after their
        ``# --- kernel ---`` line is taken.

    Notes
    -----
    One source file holds the generated laws, the equations of motion and the plant, so that the compiler sees all
    of it and a second process loads the machine code instead of compiling.
    """
    key = (tuple(effects), tuple(extra))
    if key not in _COMPOSED:
        _COMPOSED[key] = _compose(effects, extra)
    return _COMPOSED[key]


_COMPOSED: dict[Any, ModuleType] = {}


def _compose(effects: Sequence[Effect], extra: Sequence[tuple[str, str]]) -> ModuleType:
    parts = [_kernel_text("gyrowheel_sim", "mechanics/dynamics.py"), _cached_laws(tuple(effects))]
    parts += [_kernel_text(package, name) for package, name in (("gyrowheel_sim", "plant/kernel.py"), *extra)]
    return _compiled(parts, "the laws of the effects and the kernels of the bench")


@functools.cache
def compile_kernels(*files: tuple[str, str]) -> ModuleType:
    """Return one compiled module of kernel files, (package, file name) each; cached on disk by content."""
    return _compiled([_kernel_text(package, name) for package, name in files], "kernels of the bench")


def _compiled(parts: Sequence[str], what: str) -> ModuleType:
    header = (
        f'"""Generated: {what} in one compiled module."""\n'
        "import math\nfrom typing import Any, NamedTuple\n\nimport numpy as np\n"
        "from numba import njit\nfrom numba.extending import register_jitable\n\n"
    )
    text = header + "\n\n".join(parts)
    digest = hashlib.sha256(
        "\0".join((text, numba.__version__, np.__version__, sys.version)).encode()
    ).hexdigest()[:20]
    name = f"gyrowheel_kernel_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_text(path, text)
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:  # pragma: no cover - only a broken interpreter gets here
        raise RuntimeError(f"cannot load the generated module {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@functools.cache
def cache_folder() -> Path:
    """Return the folder of compiled kernels: ``$GYROWHEEL_CACHE``, the user's cache folder, or a temporary one."""
    base = os.environ.get("GYROWHEEL_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "gyrowheel"
    )
    folder = Path(base)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="gyrowheel-cache-"))
    return folder


@functools.cache
def _cached_laws(effects: tuple[Effect, ...]) -> str:
    """Return `laws_source`, kept on disk by the text of the declarations (SymPy takes seconds, reading none)."""
    own = resources.files("gyrowheel_sim").joinpath("effects/code.py").read_text(encoding="utf-8")
    declared = [
        (e.name, [(law.target, sp.srepr(law.expression)) for law in e.laws], [c.name for c in e.coefficients])
        for e in effects
    ]
    digest = hashlib.sha256(repr((own, declared, sp.__version__)).encode()).hexdigest()[:20]
    path = cache_folder() / f"gyrowheel_laws_{digest}.txt"
    if path.is_file():
        return path.read_text(encoding="utf-8")
    text = laws_source(effects)
    write_text(path, text)
    return text


def _kernel_text(package: str, name: str) -> str:
    text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
    body = text.split(_MARK, 1)[1].split(_END, 1)[0]
    return f"# from {package}/{name}\n" + re.sub(r"^\n+", "", body)


@functools.cache
def array_law(effect: Effect, index: int) -> Callable[..., Any]:
    """Return law number `index` of an effect as a function of arrays.

    The function takes keyword arguments: the quantities of `QUANTITIES` and the coefficients; all broadcast.
    """
    law = effect.laws[index]
    symbols = [q.symbol for q in QUANTITIES.values()] + [c.symbol for c in effect.coefficients]
    names = [s.name for s in symbols]

    def shared(expression: sp.Expr) -> Any:
        # names that no coefficient has
        return sp.cse(expression, symbols=sp.numbered_symbols("_s"), list=False)

    function = sp.lambdify(symbols, law.expression, modules="numpy", cse=shared)

    def evaluate(values: Mapping[str, Any]) -> Any:
        return function(*(values[name] for name in names))

    evaluate.__doc__ = f"{law.target} [{TARGETS[law.target][0]}] of {effect.name}."
    return evaluate
