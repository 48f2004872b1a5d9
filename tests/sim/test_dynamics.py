"""The equations of motion: what is printed, what is derived, what is compiled, and what another engine says."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import mujoco
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from gyrowheel_control.loops.controller import loop_code
from gyrowheel_core.units import DEG, RPM
from gyrowheel_sim.jit import compile_kernels
from gyrowheel_sim.mechanics import derivation as d
from gyrowheel_sim.mechanics.dynamics import (
    Spin,
    case_accelerations,
    case_to_joint,
    generalised_forces,
    inertia_terms,
    inverse,
    joint_accelerations,
    moving_case_forces,
    spin_axis,
)
from gyrowheel_sim.mechanics.inverse import N_POINT
from gyrowheel_sim.mechanics.kinematics import (
    case_to_motor,
    gimbal_to_rotor,
    joint_of_azimuth,
    motor_to_gimbal,
)
from gyrowheel_sim.plant.compiled import PlantParameters
from gyrowheel_sim.plant.machine import Machine
from gyrowheel_sim.plant.scenario import Scenario

from .helpers import BENCH, INERTIAS, QUIET, TUNING_INERTIA, flexure_forces, perfect_hold

X, Y, Z = d.ANGLES
SINES = dict(zip(("sx", "cx", "sy", "cy", "sz", "cz"), sp.symbols("sx cx sy cy sz cz"), strict=True))
TRIG = {
    sp.sin(X): SINES["sx"], sp.cos(X): SINES["cx"], sp.sin(Y): SINES["sy"], sp.cos(Y): SINES["cy"],
    sp.sin(Z): SINES["sz"], sp.cos(Z): SINES["cz"],
}  # fmt: skip
UNIT_CIRCLES = [SINES[f"s{a}"] ** 2 + SINES[f"c{a}"] ** 2 - 1 for a in "xyz"]
ALL_INERTIAS = (*d.ROTOR_INERTIA, *d.GIMBAL_INERTIA, d.SHAFT_INERTIA)


def canonical(expression: sp.Expr) -> sp.Expr:
    """Write an expression as a polynomial in sines and cosines in the one way: zero if and only if it is zero."""
    exact = sp.nsimplify(sp.expand_trig(expression), rational=True).subs(TRIG)
    return sp.reduced(sp.expand(exact), UNIT_CIRCLES, *SINES.values())[1]


def agree(first: sp.Expr, second: sp.Expr) -> bool:
    return bool(canonical(sp.sympify(first) - sp.sympify(second)) == 0)


# --- what is printed: Huo et al. 2016, eq (6), eq (8), Appendices A and B ---------------------------------

NOTATION: dict[str, Any] = {
    "S_x": sp.sin(X), "C_x": sp.cos(X), "S_y": sp.sin(Y), "C_y": sp.cos(Y), "S_z": sp.sin(Z), "C_z": sp.cos(Z),
    "S_2x": sp.sin(2 * X), "S_2y": sp.sin(2 * Y), "C_2y": sp.cos(2 * Y), "x": X, "y": Y,
    "K_x": d.STIFFNESS[0], "K_y": d.STIFFNESS[1], **{s.name: s for s in ALL_INERTIAS},
}  # fmt: skip
#: Elements of the mass matrix, each as the list of its terms.
PRINTED_MASS = {
    (0, 0): ["I_gx", "I_rx*C_y**2", "I_rz*S_y**2"],
    (0, 1): [],
    (0, 2): ["(I_rz - I_rx)*C_x*S_2y/2"],
    (1, 1): ["I_ry"],
    (1, 2): ["I_ry*S_x"],
    (2, 2): ["I_mz", "(I_rx*S_y**2 + I_rz*C_y**2 + I_gz)*C_x**2", "(I_ry + I_gy)*S_x**2"],
}
#: F_nl: what multiplies each product of two rates, in each of the three equations.
PRINTED_VELOCITY = {
    (0, "zy"): "-((I_rz - I_rx)*C_2y - I_ry)*C_x",
    (0, "zz"): "-(I_gz - I_gy - I_ry + I_rx*S_y**2 + I_rz*C_y**2)*S_2x/2",
    (0, "xy"): "-(I_rz - I_rx)*S_2y",
    (1, "xx"): "(I_rz - I_rx)*S_2y/2",
    (1, "zx"): "((I_rz - I_rx)*C_2y - I_ry)*C_x",
    (1, "zz"): "-(I_rz - I_rx)*C_x**2*S_2y/2",
    (2, "xz"): "-(I_gy + I_ry - I_gz - I_rz*C_y**2 - I_rx*S_y**2)*S_2x",
    (2, "xy"): "-((I_rz - I_rx)*C_2y + I_ry)*C_x",
    (2, "xx"): "(I_rz - I_rx)*S_x*S_y*C_y",
    (2, "yz"): "(I_rz - I_rx)*C_x**2*S_2y",
}
#: Torques of the coils (T_cx, T_cy) in case axes to the first two generalised forces, eq (8).
PRINTED_COILS = [["C_z", "S_z"], ["-S_z*C_x", "C_z*C_x"]]
#: Disturbing torque (T_dx, T_dy, T_dz) to the generalised forces; eq (6) subtracts the product.
PRINTED_DISTURBANCE = [["C_y", "0", "S_y"], ["0", "1", "0"], ["-C_x*S_y", "-S_x", "C_x*C_y"]]
PRINTED_POTENTIAL = "K_x*x**2 + K_y*y**2"


def printed(text: str) -> sp.Expr:
    return sp.sympify(text, locals=NOTATION)


def velocity_coefficient(equations: d.Equations, row: int, pair: str) -> sp.Expr:
    """Return what multiplies the product of two rates in one of the derived equations."""
    rates = dict(zip("xyz", d.RATES, strict=True))
    factor = 2 if pair[0] == pair[1] else 1
    return equations.velocity[row].diff(rates[pair[0]], rates[pair[1]]) / factor


@pytest.fixture(scope="session")
def published() -> d.Equations:
    return d.derive(body_rate=False)


@pytest.mark.parametrize("element", PRINTED_MASS, ids=str)
def test_printed_mass_matrix_is_right(published, element):
    assert agree(published.mass[element], sum(map(printed, PRINTED_MASS[element]), sp.Integer(0)))
    assert agree(published.mass[element], published.mass[element[::-1]])


@pytest.mark.parametrize("place", PRINTED_VELOCITY, ids=str)
def test_printed_velocity_term_is_right(published, place):
    assert agree(velocity_coefficient(published, *place), printed(PRINTED_VELOCITY[place]))


def test_no_velocity_term_is_missing(published):
    """What is not printed is zero, and nothing is of another order than two in the rates."""
    for row in range(3):
        total = sum(
            printed(text) * sp.prod(dict(zip("xyz", d.RATES, strict=True))[c] for c in pair)
            for (at, pair), text in PRINTED_VELOCITY.items()
            if at == row
        )
        assert agree(published.velocity[row], total)


@pytest.mark.parametrize(("row", "column"), list(itertools.product(range(2), range(2))))
def test_printed_map_of_the_coils_is_right(published, row, column):
    assert agree(published.case_torque[row, column], printed(PRINTED_COILS[row][column]))


def test_map_of_a_torque_along_z(published):
    """Eq (8) leaves out T_cz: it adds S_x T_cz to the second force and T_cz to the third; T_cx, T_cy add none there."""
    assert agree(published.case_torque[0, 2], 0)
    assert agree(published.case_torque[1, 2], sp.sin(X))
    assert list(published.case_torque[2, :]) == [0, 0, 1]


# --- what of the printed is wrong -------------------------------------------------------------------------


def test_printed_potential_needs_a_half(published):
    """Lagrange's equations with the printed V give twice the stiffness that the printed eq (6) has."""
    stiffness = sp.diag(*d.STIFFNESS, 0) * sp.Matrix(d.ANGLES)  # third column of eq (6)
    force = -sp.Matrix([printed(PRINTED_POTENTIAL).diff(angle) for angle in d.ANGLES])
    assert force == -2 * stiffness
    assert published.elastic == -stiffness
    assert published.potential == printed(PRINTED_POTENTIAL) / 2


def test_printed_map_of_the_disturbance_has_one_wrong_sign(published):
    """Eight of nine elements are those of virtual work; element (3, 2) must be +S_x."""
    wrong = [
        (row, column)
        for row, column in itertools.product(range(3), range(3))
        if not agree(published.rotor_torque[row, column], printed(PRINTED_DISTURBANCE[row][column]))
    ]
    assert wrong == [(2, 1)]
    assert agree(published.rotor_torque[2, 1], -printed(PRINTED_DISTURBANCE[2][1]))


def test_power_of_the_disturbance(published):
    """A torque on the rotor does the work T . omega; with the printed map it does another."""
    T = sp.Matrix(sp.symbols("T_dx T_dy T_dz"))
    rates, work = sp.Matrix(d.RATES), (T.T * published.rotor_rate)[0]
    as_printed = sp.Matrix(3, 3, lambda row, column: printed(PRINTED_DISTURBANCE[row][column]))
    assert agree((rates.T * published.rotor_torque * T)[0], work)
    left_over = (rates.T * as_printed * T)[0] - work
    assert agree(left_over, -2 * sp.sin(X) * d.RATES[2] * T[1])


def test_printed_map_turns_with_the_rotor():
    """The printed map takes components along the ROTOR's axes, which spin: constant ones are a 1N torque and no DC.

    What a still air does to the tilted rotor is constant in the case. That is what `generalised_forces` maps.
    """
    angle = np.arange(360) * DEG
    still = np.zeros(360, complex)
    tilt = np.tan(3.0 * DEG) + still
    spin = np.full(360, 3500.0 * RPM)
    joint = inverse(Spin(tilt, still, still, angle, spin, 0.0 * angle), (1, 1, 2, 0, 0, 0, 0))
    sy, cy = np.sin(joint.theta_y), np.cos(joint.theta_y)
    torque = 1e-3

    def in_case_axes(forces: tuple[Any, Any]) -> Any:
        """Return the torque across z in case axes that gives these generalised forces (the inverse of eq (8))."""
        return np.exp(1j * angle) * (forces[0] + 1j * forces[1] / joint.cx)

    spinning = in_case_axes((torque * cy, 0.0 * sy))  # first column of the printed map
    assert abs(spinning.mean()) < 1e-3 * torque
    assert abs((spinning * np.exp(-1j * angle)).mean()) == pytest.approx(torque, rel=2e-3)
    fixed = in_case_axes(generalised_forces(joint.sx, joint.cx, joint.sz, joint.cz, torque, 0.0, 0.0)[:2])
    np.testing.assert_allclose(fixed, torque, atol=1e-15)


@pytest.mark.parametrize(
    ("torque", "lost", "ripple"), [(1.153e-3, 0.0, 0.060e-3), (0.278e-3j, 0.0146e-3, 0.0146e-3)]
)
def test_size_of_the_wrong_sign(torque, lost, ripple):
    """On the shaft at 3 deg, for an air torque of the usual size in phase with the tilt and one across it."""
    angle, z = np.arange(360) * DEG, np.tan(3.0 * DEG)
    theta_x, theta_y = joint_of_azimuth(3.0 * DEG, -angle)
    to_rotor = gimbal_to_rotor(theta_y) @ motor_to_gimbal(theta_x) @ case_to_motor(angle)
    in_rotor = to_rotor @ [torque.real, torque.imag, z * torque.imag]  # across the spin axis
    error = -2.0 * np.sin(theta_x) * in_rotor[:, 1]
    assert abs(error.mean()) == pytest.approx(lost, abs=0.0001e-3)
    assert 2.0 * abs((error * np.exp(-2j * angle)).mean()) == pytest.approx(ripple, abs=0.0005e-3)
    # without the error the share on the shaft is the z component, as eq (8) with its z part has it
    sx, cx, sy, cy = np.sin(theta_x), np.cos(theta_x), np.sin(theta_y), np.cos(theta_y)
    right = -cx * sy * in_rotor[:, 0] + sx * in_rotor[:, 1] + cx * cy * in_rotor[:, 2]
    np.testing.assert_allclose(right, z * torque.imag, atol=1e-18)


def test_size_of_the_missing_half():
    """With twice the stiffness the bench is tuned at 4949 rpm, and needs 13.45 instead of 6.42 mN m at 1000 rpm."""
    stiffness, z = BENCH.value("flexure_stiffness_x"), np.tan(3.0 * DEG)
    assert np.sqrt(2.0 * stiffness / TUNING_INERTIA) / RPM == pytest.approx(3500.0, abs=1.0)
    assert np.sqrt(4.0 * stiffness / TUNING_INERTIA) / RPM == pytest.approx(4949.0, abs=1.0)
    once = perfect_hold(3.0, 1000.0).coil_harmonic(0).real
    assert once + stiffness * (1.0 - z**2 / 4.0) * z == pytest.approx(13.45e-3, abs=0.005e-3)


# --- what is compiled -------------------------------------------------------------------------------------


def test_compiled_terms_are_the_derived_ones(published):
    """The functions of `dynamics` take symbols as well as numbers: the comparison is exact."""
    sx, cx, sy, cy, sz, cz = SINES.values()
    m11, m13, m22, m23, m33, f1, f2, f3 = inertia_terms(
        sx, cx, sy, cy, *d.RATES, *d.ROTOR_INERTIA, *d.GIMBAL_INERTIA, d.SHAFT_INERTIA
    )
    mass = sp.Matrix([[m11, 0, m13], [0, m22, m23], [m13, m23, m33]])
    for mine, derived in zip(mass, published.mass, strict=True):
        assert agree(mine, derived)
    for mine, derived in zip((f1, f2, f3), published.velocity, strict=True):
        assert agree(mine, derived)
    torque = sp.symbols("T_x T_y T_z")
    forces = generalised_forces(sx, cx, sz, cz, *torque)
    for mine, derived in zip(forces, published.case_torque * sp.Matrix(torque), strict=True):
        assert agree(mine, derived)


def test_compiled_solution_of_the_mass_matrix():
    m11, m13, m22, m23, m33, b1, b2, b3 = symbols = sp.symbols("m11 m13 m22 m23 m33 b1 b2 b3")
    solved = joint_accelerations(*symbols)
    mass = sp.Matrix([[m11, 0, m13], [0, m22, m23], [m13, m23, m33]])
    assert sp.simplify(mass * sp.Matrix(solved) - sp.Matrix([b1, b2, b3])) == sp.zeros(3, 1)


ANGLE = st.floats(-0.3, 0.3)
TURN = st.floats(-np.pi, np.pi)
RATE = st.floats(-300.0, 300.0)
ACCELERATION = st.floats(-3e4, 3e4)
TORQUE = st.floats(-1.0, 1.0)


@functools.cache
def numeric(name: str) -> Any:
    """Return a matrix of the equations without body rate as a function of (angles, rates)."""
    return sp.lambdify([d.ANGLES, d.RATES], getattr(d.derive(body_rate=False), name), cse=True)


@settings(deadline=None)
@given(st.tuples(ANGLE, ANGLE, TURN), st.tuples(RATE, RATE, RATE), st.tuples(TORQUE, TORQUE, TORQUE))
def test_virtual_work_of_generalised_forces(angles, rates, torque):
    """Power balance: Q . q' is T . omega of the rotor, both taken in case axes."""
    x, _, z = angles
    to_rotor = numeric("gimbal_to_rotor")(angles, rates) @ numeric("motor_to_gimbal")(angles, rates)
    to_rotor = to_rotor @ numeric("case_to_motor")(angles, rates)
    omega = to_rotor.T @ numeric("rotor_rate")(angles, rates)[:, 0]
    Q = generalised_forces(np.sin(x), np.cos(x), np.sin(z), np.cos(z), *torque)
    scale = np.linalg.norm(torque) * np.linalg.norm(rates)
    assert abs(np.dot(Q, rates) - np.dot(torque, omega)) <= 1e-14 * scale + 1e-100


@functools.cache
def axis_expressions() -> Any:
    """Return n and its first two derivatives by differentiating its formula in the joint angles along a motion."""
    t = sp.Symbol("t")
    motion = [sum(c * t**k for k, c in enumerate(sp.symbols(f"{n}0:3"))) for n in "xyz"]
    x, y, z = motion
    n = sp.Matrix(
        [
            sp.sin(x) * sp.cos(y) * sp.sin(z) + sp.sin(y) * sp.cos(z),
            -sp.sin(x) * sp.cos(y) * sp.cos(z) + sp.sin(y) * sp.sin(z),
        ]
    )
    coefficients = [sp.symbols(f"{name}0:3") for name in "xyz"]
    orders = [n.diff(t, k).subs(t, 0) if k else n.subs(t, 0) for k in range(3)]
    return sp.lambdify([c for axis in coefficients for c in axis], [list(o) for o in orders], cse=True)


@settings(deadline=None)
@given(
    st.tuples(ANGLE, RATE, ACCELERATION), st.tuples(ANGLE, RATE, ACCELERATION), st.tuples(TURN, RATE, ACCELERATION)
)  # fmt: skip
def test_case_frame_and_joint_angles_agree(x, y, z):
    """From joint angles to the case frame by plain differentiation, and back by `case_to_joint` and `inverse`."""
    halves = [c for a, b, acc in (x, y, z) for c in (a, b, acc / 2.0)]
    n, n_rate, n_acc = (np.array(order) for order in axis_expressions()(*halves))
    sz, cz = np.sin(z[0]), np.cos(z[0])
    sx, cx, sy, cy, wx, wy = case_to_joint(n[0], n[1], n_rate[0], n_rate[1], sz, cz, z[1])
    np.testing.assert_allclose(
        [sx, cx, sy, cy], [np.sin(x[0]), np.cos(x[0]), np.sin(y[0]), np.cos(y[0])], atol=1e-14
    )
    np.testing.assert_allclose([wx, wy], [x[1], y[1]], atol=1e-12 * 1000.0)
    found = case_accelerations(sx, cx, sy, cy, wx, wy, sz, cz, z[1], x[2], y[2], z[2])
    np.testing.assert_allclose(found, n_acc, atol=1e-12 * 1e6)
    # the other way: the inverse dynamics of the complex tilt finds the joint accelerations again
    nz = np.sqrt(1.0 - n @ n)
    tilt = 1j * complex(*n) / nz
    nz_rate = -(n @ n_rate) / nz
    nz_acc = -(n_rate @ n_rate + n @ n_acc + nz_rate**2) / nz
    tilt_rate = 1j * complex(*n_rate) / nz - tilt * nz_rate / nz
    tilt_acc = 1j * complex(*n_acc) / nz - 2.0 * tilt_rate * nz_rate / nz - tilt * nz_acc / nz
    axis = spin_axis(tilt, tilt_rate, tilt_acc)
    np.testing.assert_allclose(axis[2], complex(*n_acc), atol=1e-11 * 1e6)
    joint = inverse(Spin(tilt, tilt_rate, tilt_acc, z[0], z[1], z[2]), INERTIAS)
    terms = inertia_terms(sx, cx, sy, cy, wx, wy, z[1], *INERTIAS)
    needed = [force + f for force, f in zip(joint.inertial, terms[5:], strict=True)]
    np.testing.assert_allclose(joint_accelerations(*terms[:5], *needed), (x[2], y[2], z[2]), atol=1e-6)


# --- another engine ---------------------------------------------------------------------------------------

CHAIN = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body name="case">{ball}<inertial pos="0 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
      <body><joint type="hinge" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="1" diaginertia="{half_m!r} {half_m!r} {m!r}"/>
        <body><joint type="hinge" axis="1 0 0"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{g[0]!r} {g[1]!r} {g[2]!r}"/>
          <body><joint type="hinge" axis="0 1 0"/>
            <inertial pos="0 0 0" mass="1" diaginertia="{r[0]!r} {r[1]!r} {r[2]!r}"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def body_inertia(rng: np.random.Generator, size: float) -> list[float]:
    """Return moments of inertia that a body can have (none larger than the sum of the others)."""
    a, b, c = rng.uniform(0.2, 1.0, 3) * size
    return [float(b + c), float(a + c), float(a + b)]


def mujoco_forces(
    inertias: tuple[list[float], list[float], float], angles: Any, rates: Any, accelerations: Any, body: Any = None
) -> np.ndarray:  # fmt: skip
    """Return the generalised forces (x, y, z) that MuJoCo's inverse dynamics of the universal joint needs.

    `body` is (rate, acceleration) of the case in its own axes: a ball joint carries it where it is given.
    """
    r, g, m = inertias
    ball = "" if body is None else '<joint type="ball"/>'
    model = mujoco.MjModel.from_xml_string(CHAIN.format(ball=ball, r=r, g=g, m=m, half_m=m / 2.0))
    data = mujoco.MjData(model)
    order = [2, 0, 1]  # the chain has z first
    start = 0 if body is None else 3
    data.qpos[-3:] = np.asarray(angles)[order]
    data.qvel[start:], data.qacc[start:] = np.asarray(rates)[order], np.asarray(accelerations)[order]
    if body is not None:
        data.qvel[:3], data.qacc[:3] = body
    mujoco.mj_inverse(model, data)
    forces = np.array(data.qfrc_inverse[start:])
    return forces[[1, 2, 0]]


def random_motion(rng: np.random.Generator) -> tuple[Any, Any, Any]:
    angles = rng.uniform([-1.0, -1.0, -np.pi], [1.0, 1.0, np.pi])
    return angles, rng.uniform(-400.0, 400.0, 3), rng.uniform(-1e5, 1e5, 3)


@pytest.mark.parametrize("seed", range(20))
def test_eq_6_agrees_with_mujoco(seed):
    rng = np.random.default_rng(seed)
    r, g, m = body_inertia(rng, 1e-3), body_inertia(rng, 1e-4), float(rng.uniform(1e-5, 1e-3))
    angles, rates, accelerations = random_motion(rng)
    sx, sy = np.sin(angles[:2])
    cx, cy = np.cos(angles[:2])
    parameters = (*rates, *r, *g, m)
    m11, m13, m22, m23, m33, *velocity = inertia_terms(sx, cx, sy, cy, *parameters)
    mass = np.array([[m11, 0.0, m13], [0.0, m22, m23], [m13, m23, m33]])
    ours = mass @ accelerations - velocity
    theirs = mujoco_forces((r, g, m), angles, rates, accelerations)
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()


@pytest.fixture(scope="session")
def turning() -> Any:
    """Mass matrix and velocity terms with a turning case, as functions of numbers."""
    equations = d.derive(body_rate=True)
    arguments = [d.ANGLES, d.RATES, d.BODY_RATE, d.BODY_ACCELERATION, ALL_INERTIAS]
    return sp.lambdify(arguments, [equations.mass, equations.velocity], cse=True)


@pytest.mark.parametrize("seed", range(10))
def test_turning_case_agrees_with_mujoco(turning, seed):
    """A rate table: the case turns and speeds up about all three axes."""
    rng = np.random.default_rng(100 + seed)
    r, g, m = body_inertia(rng, 1e-3), body_inertia(rng, 1e-4), float(rng.uniform(1e-5, 1e-3))
    angles, rates, accelerations = random_motion(rng)
    body = rng.uniform(-100.0, 100.0, 3), rng.uniform(-1e4, 1e4, 3)
    mass, velocity = turning(angles, rates, *body, (*r, *g, m))
    theirs = mujoco_forces((r, g, m), angles, rates, accelerations, body)
    assert np.abs(mass @ accelerations - velocity[:, 0] - theirs).max() < 1e-12 * np.abs(theirs).max()


@pytest.mark.parametrize("seed", range(10))
def test_compiled_turning_case_is_the_derived_one(turning, seed):
    """`moving_case_forces` is all that a turning case adds, to rounding, for any motion and inertias."""
    rng = np.random.default_rng(300 + seed)
    inertias = (*body_inertia(rng, 1e-3), *body_inertia(rng, 1e-4), float(rng.uniform(1e-5, 1e-3)))
    angles, rates, _ = random_motion(rng)
    body = rng.uniform(-100.0, 100.0, 3), rng.uniform(-1e4, 1e4, 3)
    s, c = np.sin(angles), np.cos(angles)
    added = moving_case_forces(
        s[0], c[0], s[1], c[1], s[2], c[2], *rates, *inertias, *body[0], *body[1]
    )  # fmt: skip
    derived = (
        turning(angles, rates, *body, inertias)[1]
        - turning(angles, rates, np.zeros(3), np.zeros(3), inertias)[1]
    )
    assert np.abs(np.array(added) + derived[:, 0]).max() < 1e-12 * np.abs(derived).max()


@pytest.mark.parametrize("turning_case", [False, True])
def test_compiled_inverse_dynamics_are_those_of_arrays(turning_case):
    """Points by compiled code against `inverse`, for random motions; tilts as their angles, with derivatives."""
    rng = np.random.default_rng(17)
    n = 200
    z, z_rate, z_acc = (
        size * (rng.uniform(-1.0, 1.0, n) + 1j * rng.uniform(-1.0, 1.0, n)) for size in (0.09, 20.0, 5e3)
    )
    angle, rate, acceleration = (
        rng.uniform(0.0, 7.0, n),
        rng.uniform(50.0, 500.0, n),
        rng.uniform(-300.0, 300.0, n),
    )
    turn = rng.uniform(-1.0, 1.0, (3, n))
    motion = Spin(z, z_rate, z_acc, angle, rate, acceleration)
    joint = inverse(motion, INERTIAS, tuple(turn) if turning_case else None)
    # derivatives of the angles whose tangents are z: each component on its own
    parts = []
    for t, u, a in ((z.real, z_rate.real, z_acc.real), (z.imag, z_rate.imag, z_acc.imag)):
        p_rate = u / (1.0 + t**2)
        parts.append((p_rate, a / (1.0 + t**2) - 2.0 * t * p_rate**2))
    phi_rate, phi_acc = (x + 1j * y for x, y in zip(*parts, strict=True))
    out = np.empty((N_POINT, n))
    compile_kernels(
        ("gyrowheel_sim", "mechanics/dynamics.py"), ("gyrowheel_sim", "mechanics/inverse.py")
    ).inverse_points(
        z, phi_rate, phi_acc, np.sin(angle), np.cos(angle), rate, acceleration,
        *turn, turning_case, *INERTIAS, out,
    )  # fmt: skip
    np.testing.assert_allclose(out[0] + 1j * out[1], z_rate, rtol=1e-12)
    for row, expected in (
        (5, joint.sx),
        (6, joint.cx),
        (7, np.sin(joint.theta_y)),
        (8, np.cos(joint.theta_y)),
    ):
        np.testing.assert_allclose(out[row], expected, rtol=1e-12, atol=1e-15)
    for row, expected in ((9, joint.theta_x_rate), (10, joint.theta_y_rate)):
        np.testing.assert_allclose(out[row], expected, rtol=1e-12, atol=1e-11)
    for row, expected in zip((11, 12, 13), joint.inertial, strict=True):
        np.testing.assert_allclose(out[row], expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


def test_turning_case_at_rest_is_eq_6():
    still = dict.fromkeys((*d.BODY_RATE, *d.BODY_ACCELERATION), 0)
    turning, published = d.derive(body_rate=True), d.derive(body_rate=False)
    assert turning.mass == published.mass
    for with_rate, without in zip(turning.velocity, published.velocity, strict=True):
        assert agree(with_rate.subs(still), without)


def test_case_that_turns_about_z_adds_to_the_spin():
    """The motor's axis is that of the case: only the sum of both rates counts."""
    turning, published = d.derive(body_rate=True), d.derive(body_rate=False)
    about_z = {d.BODY_RATE[0]: 0, d.BODY_RATE[1]: 0, **dict.fromkeys(d.BODY_ACCELERATION, 0)}
    both = d.RATES[2] + d.BODY_RATE[2]
    for with_rate, without in zip(turning.velocity, published.velocity, strict=True):
        assert agree(with_rate.subs(about_z), without.subs(d.RATES[2], both))


def test_earth_rate(turning):
    """The Earth's rate alone needs I_rz Omega omega_y about x and -I_rz Omega omega_x about y: 0.036 mN m at 40 deg."""
    earth, latitude, spin = 7.292e-5, 40.0 * DEG, 3500.0 * RPM
    north = earth * np.cos(latitude)
    for rate in ((north, 0.0), (0.0, north)):
        needed = []
        for angle in np.arange(12) * 30.0 * DEG:
            body = (*rate, earth * np.sin(latitude))
            _, velocity = turning((0.0, 0.0, angle), (0.0, 0.0, spin), body, (0.0, 0.0, 0.0), INERTIAS)
            # at no tilt the generalised forces are the torques along the motor's axes
            needed.append(np.exp(1j * angle) * -complex(velocity[0, 0], velocity[1, 0]))
        mean = np.mean(needed)
        assert mean == pytest.approx(-1j * INERTIAS[2] * spin * complex(*rate), rel=0.01)
        assert abs(mean) == pytest.approx(0.036e-3, abs=0.001e-3)


# --- conservation -----------------------------------------------------------------------------------------

LOSSLESS = {
    "flexure_damping_x": 0.0, "flexure_damping_y": 0.0, "bearing_coulomb": 0.0, "bearing_viscous": 0.0,
}  # fmt: skip
KICK = np.array([0.03, -0.07, 5.0, 3.0, 0.4, 1500.0 * RPM])  # nutating at 4.4 deg


def isolated() -> tuple[Machine, PlantParameters]:
    """Return a machine on which nothing acts: no losses, no coils, and a motor without torque and back-EMF."""
    machine = Machine(BENCH, Scenario(values={**QUIET, **LOSSLESS}), initial_spin_rate=1500.0 * RPM)
    return machine, machine.parameters._replace(motor_constant=0.0)


def conserved(states: np.ndarray, p: PlantParameters) -> tuple[Any, Any, Any]:
    """Return kinetic energy, potential energy and the angular momentum about z, for states (6, n)."""
    nx, ny, ux, uy, angle, spin = states
    sx, cx, sy, cy, wx, wy = case_to_joint(nx, ny, ux, uy, np.sin(angle), np.cos(angle), spin)
    m11, m13, m22, m23, m33, *_ = inertia_terms(
        sx, cx, sy, cy, wx, wy, spin, p.rotor_inertia_x, p.rotor_inertia_y, p.rotor_inertia_z,
        p.gimbal_inertia_x, p.gimbal_inertia_y, p.gimbal_inertia_z, p.shaft_inertia,
    )  # fmt: skip
    kinetic = 0.5 * (m11 * wx**2 + m22 * wy**2 + m33 * spin**2) + m13 * wx * spin + m23 * wy * spin
    potential = 0.5 * (
        p.flexure_stiffness_x * np.arcsin(sx) ** 2 + p.flexure_stiffness_y * np.arcsin(sy) ** 2
    )
    return kinetic, potential, m13 * wx + m23 * wy + m33 * spin


@pytest.fixture(scope="module")
def free_motion() -> tuple[np.ndarray, PlantParameters]:
    """Half a second of nutation, integrated by DOP853 from the compiled accelerations."""
    machine, p = isolated()
    code = loop_code()

    def rates(t: float, state: np.ndarray) -> list[float]:
        acceleration = code.plant_rates(
            p,
            *machine.laws,
            machine.environment,
            t,
            1.2,
            machine.state,
            0.0,
            0.0,
            0.0,
            *state,
        )
        return [state[2], state[3], acceleration[0], acceleration[1], state[5], acceleration[2]]

    result = solve_ivp(rates, (0.0, 0.5), KICK, method="DOP853", rtol=2.3e-14, atol=1e-16)
    return result.y, p


def test_free_motion_keeps_energy_and_momentum(free_motion):
    states, p = free_motion
    kinetic, potential, momentum = conserved(states, p)
    energy = kinetic + potential
    exchanged = np.ptp(potential)
    assert exchanged > 1e-5  # J: the motion is one that shows
    assert np.ptp(energy) < 5e-14 * energy[0]
    assert np.ptp(energy) < 1e-7 * exchanged
    assert np.ptp(momentum) < 5e-14 * momentum[0]


def test_energy_with_the_printed_potential_is_not_kept(free_motion):
    """With V = Kx x^2 + Ky y^2 as printed, T + V swings by as much as the flexures store."""
    states, p = free_motion
    kinetic, potential, _ = conserved(states, p)
    assert np.ptp(kinetic + 2.0 * potential) == pytest.approx(np.ptp(potential), rel=1e-6)


def test_steps_keep_energy_and_momentum():
    """The plant's own Runge-Kutta step at a fine step; at the default step the error stays far below the noise."""
    machine, p = isolated()
    code = loop_code()
    drifts = []
    for divide in (1, 25):
        fine = p._replace(sample_period=BENCH.sample_period / divide)
        machine.state[:6] = KICK
        before = conserved(KICK[:, None], p)
        for _ in range(100 * divide):
            code.plant_step(
                fine, *machine.laws, machine.environment, machine.state, 0.0,
                0.0, 0.0, 0.0
            )  # fmt: skip
        after = conserved(machine.state[:6, None], p)
        energy = abs(after[0] + after[1] - before[0] - before[1]) / before[0]
        drifts.append((energy[0], abs(after[2] / before[2] - 1.0)[0]))
    assert max(drifts[1]) < 2e-13
    assert max(drifts[0]) < 1e-7


def test_flexure_forces_of_the_plant():
    """The compiled plant has the stiffness once, not twice: it falls back to the centre with the torque K theta."""
    machine, p = isolated()
    tilt = 0.01
    acceleration = loop_code().plant_rates(
        p, *machine.laws, machine.environment, 0.0, 1.2, machine.state, 0.0,
        0.0, 0.0,
        0.0, -np.sin(tilt), 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip
    joint = inverse(Spin(np.tan(tilt) + 0j, 0j, 0j, 0.0, 0.0, 0.0), (1, 1, 1, 0, 0, 0, 1))
    torque, _ = flexure_forces(joint)
    inertia = p.rotor_inertia_x + p.gimbal_inertia_x
    assert acceleration[1] == pytest.approx(-torque / inertia, rel=1e-3)


# --- a rotor that is not round ------------------------------------------------------------------------------


@pytest.mark.parametrize("difference", [0.0, 2e-5])
def test_an_asymmetric_rotor_beats_at_twice_the_spin_minus_the_nutation(difference):
    """Free nutation of a rotor with Irx and Iry apart has a second line, at 2 Omega - omega_n; a round one has none.

    Remark 1 of the paper names such beat frequencies. The gimbal, which follows one of the two tilts at a time, makes a
    little of it too and is taken away here. Between two lines of the spectrum there is nothing.
    """
    without_gimbal = {f"gimbal_inertia_{axis}": 0.0 for axis in "xyz"}
    values = {**QUIET, **LOSSLESS, **without_gimbal, "motor_constant": 1e-9}
    effects = {"inertia_anisotropy": {"d": difference}}
    rate = 1500.0 * RPM
    machine = Machine(BENCH, Scenario(values=values, effects=effects), initial_spin_rate=rate)
    machine.state[2] = 0.5
    code, n = loop_code(), 8000
    z = np.empty(n, dtype=complex)
    for k in range(n):
        code.plant_step(
            machine.parameters, *machine.laws, machine.environment,
            machine.state,
            k * BENCH.sample_period, 0.0, 0.0, 0.0,
        )  # fmt: skip
        z[k] = complex(machine.state[0], machine.state[1])
    spectrum = np.abs(np.fft.fft((z - z.mean()) * np.blackman(n))) / n
    frequency = np.fft.fftfreq(n, BENCH.sample_period)

    def line(hertz: float) -> float:
        return float(spectrum[np.abs(frequency - hertz) < 1.0].max())

    nutation = float(frequency[np.argmax(spectrum)])
    mean_inertia = BENCH.value("rotor_inertia_x")
    spin = float(machine.state[5]) / (2.0 * np.pi)
    assert nutation == pytest.approx(BENCH.value("rotor_inertia_z") / mean_inertia * spin, rel=0.02)
    beat = line(2.0 * spin - nutation)
    beside = line(2.0 * spin - nutation + 6.0)
    if difference:
        assert beat > 20.0 * beside
        # as large as the unevenness, to a factor: the response to it is far from resonance
        assert 0.2 < beat / line(nutation) / (difference / mean_inertia) < 20.0
    else:
        assert beat < 1e-3 * line(nutation)
