"""The equations of motion derived symbolically by Lagrange's method, also for a case that turns itself.

`gyrowheel_sim.mechanics.dynamics` holds the published equations, eq (6) of Huo et al. 2016, as compiled code.
This module derives them independently from the energies; the tests compare the two. It goes beyond eq (6): the case
may turn at any rate (a rate table, the Earth).

Frames, all passive rotations: case -> motor by Rz(theta_z), motor -> gimbal by Rx(theta_x), gimbal -> rotor by
Ry(theta_y).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import sympy as sp

_Triple = tuple[sp.Symbol, sp.Symbol, sp.Symbol]


def _real(names: str) -> _Triple:
    return tuple(sp.symbols(names, real=True))


#: Generalised coordinates and their rates [rad], [rad/s].
ANGLES = _real("theta_x theta_y theta_z")
RATES = _real("theta_x_rate theta_y_rate theta_z_rate")
#: Rate of the case in inertial space, components along the case's axes, and its derivative [rad/s], [rad/s^2].
BODY_RATE = _real("omega_bx omega_by omega_bz")
BODY_ACCELERATION = _real("alpha_bx alpha_by alpha_bz")
#: Moments of inertia of rotor and gimbal about their own axes, and of the shaft about the case's z axis [kg m^2].
ROTOR_INERTIA = _real("I_rx I_ry I_rz")
GIMBAL_INERTIA = _real("I_gx I_gy I_gz")
SHAFT_INERTIA: sp.Symbol = sp.Symbol("I_mz", real=True)
#: Stiffness [N m/rad] and viscous damping [N m s/rad] of the flexures.
STIFFNESS: tuple[sp.Symbol, sp.Symbol] = tuple(sp.symbols("K_x K_y", real=True))
DAMPING: tuple[sp.Symbol, sp.Symbol] = tuple(sp.symbols("C_x C_y", real=True))
#: Spin rate of the slow equation [rad/s].
SPIN_RATE: sp.Symbol = sp.Symbol("Omega", positive=True)


@dataclass(frozen=True)
class Equations:
    """Equations of motion ``mass q'' = Q + velocity`` with q = `ANGLES` and Q every generalised force."""

    mass: sp.Matrix  # mass matrix, a function of the angles [kg m^2]
    #: Everything of the inertia that does not multiply q'': centrifugal and gyroscopic torques and, where the
    #: case turns, those of its rate and of its angular acceleration [N m].
    velocity: sp.Matrix
    elastic: sp.Matrix  # generalised force of the flexures, -dV/dq; part of Q [N m]
    #: ``Q = case_torque T`` for a torque T on the rotor given in case axes, and likewise in rotor axes.
    case_torque: sp.Matrix
    rotor_torque: sp.Matrix
    #: Rotation matrices; each turns components in the first frame into components in the second.
    case_to_motor: sp.Matrix
    motor_to_gimbal: sp.Matrix
    gimbal_to_rotor: sp.Matrix
    #: Angular velocities of the three bodies, each in its own axes: eqs (3), (4), (5) [rad/s].
    shaft_rate: sp.Matrix
    gimbal_rate: sp.Matrix
    rotor_rate: sp.Matrix
    #: The energies T and V of the Lagrangian T - V [J].
    kinetic: sp.Expr
    potential: sp.Expr


@functools.cache
def derive(body_rate: bool = True) -> Equations:
    """Derive the equations of motion from the energies.

    Parameters
    ----------
    body_rate : bool
        Whether the case may turn at `BODY_RATE` with `BODY_ACCELERATION`; if not, both are zero, as in eq (6).

    Returns
    -------
    Equations
        Expressions in the symbols of this module, not simplified: lambdify them with ``cse=True``.

    Examples
    --------
    >>> equations = derive(body_rate=False)
    >>> equations.mass[0, 1]
    0
    """
    x, y, z = ANGLES
    q, u = sp.Matrix(ANGLES), sp.Matrix(RATES)
    w = sp.Matrix(BODY_RATE) if body_rate else sp.zeros(3, 1)
    a = sp.Matrix(BODY_ACCELERATION) if body_rate else sp.zeros(3, 1)
    to_motor = sp.Matrix([[sp.cos(z), sp.sin(z), 0], [-sp.sin(z), sp.cos(z), 0], [0, 0, 1]])
    to_gimbal = sp.Matrix([[1, 0, 0], [0, sp.cos(x), sp.sin(x)], [0, -sp.sin(x), sp.cos(x)]])
    to_rotor = sp.Matrix([[sp.cos(y), 0, -sp.sin(y)], [0, 1, 0], [sp.sin(y), 0, sp.cos(y)]])
    shaft = to_motor * w + sp.Matrix([0, 0, u[2]])
    gimbal = to_gimbal * shaft + sp.Matrix([u[0], 0, 0])
    rotor = to_rotor * gimbal + sp.Matrix([0, u[1], 0])
    # the shaft is round: its inertia across z does not depend on any angle and drops out
    kinetic = (
        SHAFT_INERTIA * shaft[2] ** 2
        + sum(i * rate**2 for i, rate in zip(GIMBAL_INERTIA, gimbal, strict=True))
        + sum(i * rate**2 for i, rate in zip(ROTOR_INERTIA, rotor, strict=True))
    ) / 2
    potential = (STIFFNESS[0] * x**2 + STIFFNESS[1] * y**2) / 2
    momentum = sp.Matrix([kinetic.diff(rate) for rate in u])
    mass = momentum.jacobian(u)
    # d/dt of the momentum, without the part of q''
    drift = momentum.jacobian(q) * u
    if body_rate:
        drift += momentum.jacobian(w) * a
    velocity = sp.Matrix([kinetic.diff(angle) for angle in q]) - drift
    virtual = rotor.jacobian(u).T
    return Equations(
        mass=mass.expand(),
        velocity=velocity,
        elastic=-sp.Matrix([potential.diff(angle) for angle in q]),
        case_torque=(virtual * to_rotor * to_gimbal * to_motor).applyfunc(sp.trigsimp),
        rotor_torque=virtual,
        case_to_motor=to_motor,
        motor_to_gimbal=to_gimbal,
        gimbal_to_rotor=to_rotor,
        shaft_rate=shaft,
        gimbal_rate=gimbal,
        rotor_rate=rotor,
        kinetic=kinetic,
        potential=potential,
    )


@dataclass(frozen=True)
class SlowEquation:
    """The equation of a small tilt z = tan(phi_x) + i tan(phi_y) in the case, averaged over a revolution.

    The coils must give ``T_x + i T_y = inertia z'' - i momentum z' + stiffness z + damping (z' - i Omega z)``.
    """

    inertia: sp.Expr  # [kg m^2]
    momentum: sp.Expr  # angular momentum against which a tilt is slewed [kg m^2/s]
    stiffness: sp.Expr  # holding torque per tilt; zero at the tuned speed [N m/rad]
    damping: sp.Expr  # [N m s/rad]


@functools.cache
def average() -> SlowEquation:
    """Derive the slow equation: `derive` to the first order in the tilt, averaged over theta_z at a constant spin rate.

    Returns
    -------
    SlowEquation
        Expressions in `ROTOR_INERTIA` (with I_ry = I_rx), `GIMBAL_INERTIA`, `STIFFNESS`, `DAMPING` and `SPIN_RATE`.
    """
    equations = derive(body_rate=False)
    t, small = sp.symbols("t epsilon", real=True)
    # the tilt with its first two derivatives; to the first order theta_x + i theta_y = z exp(-i theta_z)
    x, y = (sp.symbols(f"{name}0:3", real=True) for name in ("x", "y"))
    path_x, path_y = (sum(c * t**k / sp.factorial(k) for k, c in enumerate(axis)) for axis in (x, y))
    turn = ANGLES[2] + SPIN_RATE * t
    theta_x = path_x * sp.cos(turn) + path_y * sp.sin(turn)
    theta_y = path_y * sp.cos(turn) - path_x * sp.sin(turn)
    first, second, third = ([small * e.diff(t, k).subs(t, 0) for e in (theta_x, theta_y)] for k in range(3))
    at = dict(zip((*ANGLES[:2], *RATES), (*first, *second, SPIN_RATE), strict=True))
    loss = sp.Matrix([DAMPING[0] * RATES[0], DAMPING[1] * RATES[1], 0])
    force = equations.mass * sp.Matrix([*third, 0]) - equations.velocity - equations.elastic + loss
    linear = force.subs(at).diff(small).subs(small, 0)
    torque = sp.exp(sp.I * ANGLES[2]) * (linear[0] + sp.I * linear[1])
    # a linear torque has the harmonics 0 and 2 of the spin alone: four angles give its mean exactly
    mean = sp.expand(sum(torque.subs(ANGLES[2], k * sp.pi / 2) for k in range(4)) / 4)
    mean = mean.subs(ROTOR_INERTIA[1], ROTOR_INERTIA[0])
    # what multiplies z, z' and z'', read off the real axis
    by_tilt, by_rate, inertia = (sp.expand(mean.coeff(c)) for c in x)
    return SlowEquation(
        inertia=inertia,
        momentum=sp.factor(-sp.im(by_rate)),
        stiffness=sp.collect(sp.re(by_tilt), SPIN_RATE),
        damping=sp.re(by_rate),
    )
