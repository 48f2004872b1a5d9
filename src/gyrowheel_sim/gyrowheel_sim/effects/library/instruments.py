"""Instruments that are not as the bench file states them.

A law adds to the bench parameter of its instrument (`gyrowheel_sim.effects.targets.INSTRUMENT_PARAMETERS`);
`gyrowheel_sim.instruments` applies these parameters to the readings.
"""

from __future__ import annotations

from collections.abc import Mapping

from gyrowheel_sim.effects.declaration import Effect, Law
from gyrowheel_sim.effects.library.common import amplitude, symbols
from gyrowheel_sim.parameter import LONGEST_DELAY

_ROTATE = "several speeds: a delay turns the phase in proportion to the speed, the other does not"
_WEAKEN = (
    "several speeds up to the highest: a filter also weakens what turns with the rotor, a delay does not"
)
_SKEW = "nothing on this bench: only the instants of two channels against each other are seen; read the timing of one"
_BOTH = "cones, next to what turns with the rotor: a late reading shows in both, in proportion to each rate"
_VOLTAGE = "a current of the coils, measured: the inductance delays it, an instrument of the voltage does not"


def _delay(channel: str, what: str, sentence: str, look_alikes: Mapping[str, str]) -> Effect:
    (late,) = symbols("d")
    return Effect(
        name=f"{channel}_delay",
        title=f"{what} read at another instant than stated",
        category="instrument",
        sentence=sentence,
        directions=(
            f"The reading of the {what} is early: it shows a later instant than stated.",
            f"The reading of the {what} is late: it shows an earlier instant than stated.",
        ),
        laws=(Law(f"{channel}_delay", late),),
        coefficients=(
            amplitude(
                "d",
                "s",
                "how much longer before the stamp it is read than stated; negative: less long",
                (1.0e-4, 5.0e-4),
                LONGEST_DELAY,
                "assumed: up to one sampling interval of the default bench",
                signed=True,
            ),
        ),
        validity="constant over the recording",
        source="instrument model: the reading stamped t shows its quantity at t less the delay",
        look_alikes=look_alikes,
    )


def _filter(channel: str, title: str, sentence: str, look_alikes: Mapping[str, str]) -> Effect:
    (time,) = symbols("t_f")
    return Effect(
        name=f"{channel}_filter",
        title=title,
        category="instrument",
        sentence=sentence,
        laws=(Law(f"{channel}_filter_time", time),),
        coefficients=(
            amplitude(
                "t_f",
                "s",
                "time constant of each pole beyond the stated one",
                (1.0e-4, 5.0e-4),
                LONGEST_DELAY,
                "assumed: corners of 300 Hz to 1.6 kHz, as anti-aliasing filters have",
            ),
        ),
        validity="as many equal poles as the bench file states, one if it states none; no time constant below zero",
        source="instrument model: low-pass filter of equal poles",
        look_alikes=look_alikes,
    )


TILT_DELAY = _delay(
    "tilt",
    "tilts",
    "The tilts are sampled at another instant than the stamp says.",
    {
        "tilt_filter": _WEAKEN,
        "tilt_rotation": _ROTATE,
        "external_damping": _BOTH,
        "coil_voltage_delay": _SKEW,
        "spin_angle_delay": _SKEW,
    },
)
SPIN_ANGLE_DELAY = _delay(
    "spin_angle",
    "angle of the shaft",
    "The angle of the shaft is sampled at another instant than the stamp says.",
    {"encoder_zero": _ROTATE, "tilt_delay": _SKEW, "coil_voltage_delay": _SKEW},
)
COIL_VOLTAGE_DELAY = _delay(
    "coil_voltage",
    "coil voltages",
    "The coil voltages are sampled at another instant than the stamp says, before or after the converter's latch.",
    {
        "coil_inductance": _VOLTAGE,
        "coil_voltage_filter": _WEAKEN,
        "tilt_delay": _SKEW,
        "spin_angle_delay": _SKEW,
    },
)
MOTOR_VOLTAGE_DELAY = _delay(
    "motor_voltage",
    "motor voltage",
    "The motor voltage is sampled at another instant than the stamp says, before or after the converter's latch.",
    {"motor_voltage_filter": _WEAKEN, "motor_current_delay": _SKEW},
)
MOTOR_CURRENT_DELAY = _delay(
    "motor_current",
    "motor current",
    "The motor current is sampled at another instant than the stamp says.",
    {"motor_current_filter": _WEAKEN, "motor_voltage_delay": _SKEW, "commutation_ripple": _ROTATE},
)
TILT_FILTER = _filter(
    "tilt",
    "filter before the converter of the tilts",
    "A low-pass filter that the bench file does not state, or states with another corner, delays the tilts.",
    {"tilt_delay": _WEAKEN, "external_damping": _BOTH},
)
COIL_VOLTAGE_FILTER = _filter(
    "coil_voltage",
    "filter before the converter of the coil voltages",
    "A low-pass filter that the bench file does not state, or states with another corner, delays the coil voltages.",
    {"coil_voltage_delay": _WEAKEN, "coil_inductance": _VOLTAGE},
)
MOTOR_VOLTAGE_FILTER = _filter(
    "motor_voltage",
    "filter before the converter of the motor voltage",
    "A low-pass filter that the bench file does not state, or states with another corner, delays the motor voltage.",
    {"motor_voltage_delay": _WEAKEN},
)
MOTOR_CURRENT_FILTER = _filter(
    "motor_current",
    "filter before the converter of the motor current",
    "A low-pass filter that the bench file does not state, or states with another corner, delays the motor current.",
    {"motor_current_delay": _WEAKEN, "commutation_ripple": _ROTATE},
)

(_zero,) = symbols("E_0")

ENCODER_ZERO = Effect(
    name="encoder_zero",
    title="zero error of the shaft's encoder",
    category="instrument",
    sentence="The angle reading is off by a constant, and all that turns with the shaft seems to stand turned.",
    directions=(
        "The angle reading lags by a constant, and all that turns with the shaft seems to stand turned.",
        "The angle reading leads by a constant, and all that turns with the shaft seems to stand turned.",
    ),
    laws=(Law("encoder_zero", _zero),),
    coefficients=(
        amplitude(
            "E_0",
            "rad",
            "reading less true angle, beyond the stated error",
            (0.01, 0.05),
            3.2,
            "assumed: 0.6 to 3 deg",
            signed=True,
        ),
    ),
    validity="constant over the recording",
    source="instrument model: reading = angle + error",
    look_alikes={
        "spin_angle_delay": _ROTATE,
        "tilt_rotation": "cones and holds: turned sensors turn the slow torques as well, the encoder does not",
    },
)


def _encoder(times: str, number: int, look_alikes: Mapping[str, str]) -> Effect:
    x, y = symbols("E_x", "E_y")
    return Effect(
        name=f"encoder_{times}",
        title=f"error of the shaft's encoder {times} a turn",
        category="instrument",
        sentence=f"The track of the encoder is not {'centred' if number == 1 else 'round'}, so the angle reading is "
        f"ahead and behind {times} a turn.",
        laws=(Law(f"encoder_{times}_x", x), Law(f"encoder_{times}_y", y)),
        coefficients=tuple(
            amplitude(
                name,
                "rad",
                f"its {part} part, beyond the stated one",
                (1.0e-3, 1.0e-2),
                0.3,
                "assumed: 20 to 200 micrometres at a radius of 20 mm",
                signed=True,
            )
            for name, part in (("E_x", "cosine"), ("E_y", "sine"))
        ),
        validity="constant over the recording",
        source="instrument model: reading = angle + E_x cos(k angle) + E_y sin(k angle)",
        look_alikes=look_alikes,
    )


ENCODER_ONCE = _encoder(
    "once",
    1,
    {"static_imbalance": "spin-angle readings against steady rotation: an imbalance does not modulate them"},
)
ENCODER_TWICE = _encoder(
    "twice",
    2,
    {
        "stiffness_anisotropy": "spin-angle readings against steady rotation: a flexure does not modulate them so"
    },
)

(_q,) = symbols("q")

TILT_NONLINEARITY = Effect(
    name="tilt_nonlinearity",
    title="tilt sensors are not linear",
    category="instrument",
    sentence="Each tilt sensor shows too much or too little in proportion to the cube of the tilt about its axis.",
    directions=(
        "Each tilt sensor shows too little, in proportion to the cube of the tilt about its axis.",
        "Each tilt sensor shows too much, in proportion to the cube of the tilt about its axis.",
    ),
    laws=(Law("tilt_cubic", _q),),
    coefficients=(
        amplitude(
            "q",
            "1/rad^2",
            "relative error of a reading over the square of the tilt, beyond the stated one",
            (0.7, 4.0),
            50.0,
            "assumed: 0.5 to 3 % at 5 deg",
            signed=True,
        ),
    ),
    validity="tilt up to 5 deg",
    source="instrument model: reading = tilt + q tilt^3, axis by axis",
    look_alikes={
        "cubic_stiffness": "cones at two radii and several speeds: slewing shows the tilt itself, not the flexure",
        "coil_tilt": "holds at several speeds: what a coil lacks goes with its torque, a reading's error with the tilt",
    },
)

(_c,) = symbols("c")

TILT_CROSS_TALK = Effect(
    name="tilt_cross_talk",
    title="cross-talk of the tilt sensors",
    category="instrument",
    sentence="Each tilt sensor shows a part of the tilt about the other axis, as if they were not at right angles.",
    directions=(
        "Each tilt sensor shows a part of the tilt about the other axis, as if the angle between them were obtuse.",
        "Each tilt sensor shows a part of the tilt about the other axis, as if the angle between them were acute.",
    ),
    laws=(Law("tilt_cross_talk", _c),),
    coefficients=(
        amplitude(
            "c",
            "1",
            "part of the tilt about the other axis that each sensor shows, beyond the stated one",
            (0.005, 0.03),
            0.3,
            signed=True,
        ),
    ),
    validity="constant over the recording",
    source="instrument model: reading about x + c times that about y, and the other way round",
    look_alikes={
        "coil_anisotropy": "tuned speed: the coils give no torque there, and what they lack vanishes with it",
        "tilt_rotation": "tilts about both axes: turned sensors show them with opposite signs, cross-talk with one",
    },
)
