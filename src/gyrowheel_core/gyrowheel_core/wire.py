"""Fixed-layout messages as bytes: the CDR that any ROS 2 node reads, without the cost of message objects.

A message whose every field has a fixed size, but for a `frame_id` that is constant, always serializes to the
same number of bytes with each field at the same place. Packing it with `struct`, or n of them as one numpy
array, then does the work of the ROS serializer in a fraction of the time. The places follow from the field
declarations by the alignment rules of CDR: every primitive lies at a multiple of its size, counted after the
encapsulation. Padding is written as zeros and never looked at (the ROS serializer leaves it undefined).
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

FRAME_ID: Final = "case"  #: frame of all stamped messages of the bench
SECOND: Final = 1_000_000_000  #: [ns]

_ENCAPSULATION: Final = b"\x00\x01\x00\x00"  # plain CDR, little endian, no options
_FORMATS: Final = {"int32": "i", "bool": "?", "uint8": "B", "uint32": "I", "uint64": "Q", "float64": "d"}
_STAMP: Final = struct.Struct("<iI")
_TIME: Final = {"sec": "int32", "nanosec": "uint32"}
_HEADER: Final = {**_TIME, "frame_id": "string"}


class Layout:
    """Where each field of one message type lies in its serialized form.

    Parameters
    ----------
    type_name : str
        Type of the message, such as ``"gyrowheel_msgs/msg/Command"``.
    declaration : dict of str to str
        Fields in message order, nested ones flat, and their types: a primitive or an array of three, such as
        ``"float64[3]"``. The first two are the stamp, ``sec`` and ``nanosec``; a ``string`` is `FRAME_ID`.

    Attributes
    ----------
    type_name : str
        As given.
    declaration : dict of str to str
        As given.
    names : tuple of str
        Names of the fields after the header, in message order.
    integers, fields : tuple of str
        Those that are integers or bool, and those that are floats.
    size : int
        Length of the serialized message, encapsulation included [bytes].
    dtype : numpy.dtype
        One serialized message as a structured type of `size` bytes: the fields by their names, and the
        constant ones ``encapsulation``, ``frame_id_length`` and ``frame_id`` where there is a header.
    """

    def __init__(self, type_name: str, declaration: dict[str, str]) -> None:
        self.type_name = type_name
        self.declaration = declaration
        self.names = tuple(name for name in declaration if name not in _HEADER)
        self.integers = tuple(name for name in self.names if not declaration[name].startswith("float"))
        self.fields = tuple(name for name in self.names if name not in self.integers)

        form = "<4s"  # format of `struct`, the padding written out
        end = 0  # of the fields so far, counted after the encapsulation
        places: dict[str, tuple[Any, int]] = {"encapsulation": ("S4", 0)}
        self._constants: dict[str, Any] = {"encapsulation": np.bytes_(_ENCAPSULATION)}
        self._prefix: tuple[Any, ...] = ()  # constants between the stamp and the other fields

        def place(name: str, code: str, dtype: Any, alignment: int) -> None:
            nonlocal form, end
            padding = -end % alignment
            form += f"{padding}x{code}"
            places[name] = (dtype, len(_ENCAPSULATION) + end + padding)
            end += padding + struct.calcsize(f"<{code}")

        for name, kind in declaration.items():
            if kind == "string":
                text = FRAME_ID.encode() + b"\0"
                place(f"{name}_length", "I", "<u4", 4)
                place(name, f"{len(text)}s", f"S{len(text)}", 1)
                self._constants |= {f"{name}_length": len(text), name: np.bytes_(text)}
                self._prefix = (len(text), text)
            else:
                code = _FORMATS[kind.removesuffix("[3]")]
                shape = (3,) if kind.endswith("[3]") else ()
                place(name, f"{3 if shape else ''}{code}", (f"<{code}", shape), struct.calcsize(f"<{code}"))
        self.size = len(_ENCAPSULATION) + end
        self.dtype = np.dtype(
            {
                "names": list(places),
                "formats": [dtype for dtype, _ in places.values()],
                "offsets": [offset for _, offset in places.values()],
                "itemsize": self.size,
            }
        )
        self._struct = struct.Struct(form)

    def pack(self, stamp_ns: int, *values: float) -> bytes:
        """Serialize one message.

        Parameters
        ----------
        stamp_ns : int
            Stamp [ns].
        *values : int or float
            The fields after the header in message order, arrays by their elements.

        Returns
        -------
        bytes
            The CDR, encapsulation included.

        Raises
        ------
        ValueError
            If the number of values is not that of the fields, or a value does not fit its field.
        """
        sec, nanosec = divmod(stamp_ns, SECOND)
        try:
            return self._struct.pack(_ENCAPSULATION, sec, nanosec, *self._prefix, *values)
        except struct.error as error:
            raise ValueError(f"{self.type_name}: cannot be packed: {error}") from None

    def unpack(self, data: bytes) -> tuple[Any, ...]:
        """Read one serialized message.

        Parameters
        ----------
        data : bytes
            The CDR, encapsulation included.

        Returns
        -------
        tuple
            stamp [ns], then the fields after the header in message order, as `pack` takes them.

        Raises
        ------
        ValueError
            If length, encapsulation, frame_id or stamp are not those of this layout.
        """
        if len(data) != self.size:
            raise ValueError(f"{self.type_name}: {len(data)} bytes; this layout has {self.size}")
        encapsulation, sec, nanosec, *rest = self._struct.unpack(data)
        if encapsulation != _ENCAPSULATION:
            raise ValueError(f"{self.type_name}: encapsulation {encapsulation.hex()}; it must be 00010000")
        if self._prefix:
            if tuple(rest[:2]) != self._prefix:
                raise ValueError(f"{self.type_name}: frame_id is not '{FRAME_ID}'")
            del rest[:2]
        if nanosec >= SECOND:
            raise ValueError(f"{self.type_name}: stamp of {nanosec} ns within a second")
        return (sec * SECOND + nanosec, *rest)

    def array(self, n: int) -> npt.NDArray[Any]:
        """Return n messages of zeros with the constant bytes in place, shape (n,).

        `tobytes()` of it is n serialized messages.
        """
        array = np.zeros(n, self.dtype)
        for name, value in self._constants.items():
            array[name] = value
        return array

    def matches(self, array: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
        """Return which messages have the constant bytes of this layout and a valid stamp.

        Parameters
        ----------
        array : numpy.ndarray of `dtype`, shape (n,)
            Messages from elsewhere.
        """
        result: npt.NDArray[np.bool_] = array["nanosec"] < SECOND
        for name, value in self._constants.items():
            result &= array[name] == value
        return result

    @functools.cached_property
    def constant_bytes(self) -> npt.NDArray[np.int64]:
        """Places and values of the bytes that are the same in every message, shape (m, 2)."""
        own = self.array(1).view(np.uint8)
        fields: Mapping[str, Any] = self.dtype.fields or {}
        spans = [(fields[name][1], fields[name][0].itemsize) for name in self._constants]
        found = [(k, own[k]) for begin, size in spans for k in range(begin, begin + size)]
        return np.array(found, dtype=np.int64).reshape(-1, 2)

    @staticmethod
    def stamps(array: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Return the stamps of the messages in `array` [ns], shape (n,)."""
        result: npt.NDArray[np.int64] = array["sec"].astype(np.int64) * SECOND + array["nanosec"]
        return result

    @staticmethod
    def set_stamps(array: npt.NDArray[Any], stamp_ns: npt.ArrayLike) -> None:
        """Put stamps [ns] into the messages in `array`."""
        array["sec"], array["nanosec"] = np.divmod(np.asarray(stamp_ns, np.int64), SECOND)


def stamp(data: bytes) -> int:
    """Return the stamp [ns] of a serialized message that begins with one, whatever its frame_id.

    Raises
    ------
    ValueError
        If it is not plain CDR in little endian, or the stamp is negative or invalid.
    """
    if data[:4] != _ENCAPSULATION or len(data) < 12:
        raise ValueError("not a stamped message in plain CDR, little endian")
    sec, nanosec = _STAMP.unpack_from(data, len(_ENCAPSULATION))
    if sec < 0 or nanosec >= SECOND:
        raise ValueError(f"a stamp of {sec} s and {nanosec} ns")
    result: int = sec * SECOND + nanosec
    return result


def pack_text(text: str) -> bytes:
    """Serialize a std_msgs/String."""
    data = text.encode() + b"\0"
    return _ENCAPSULATION + struct.pack("<I", len(data)) + data


def unpack_text(data: bytes) -> str:
    """Read a serialized std_msgs/String.

    Raises
    ------
    ValueError
        If it is not one.
    """
    if data[:4] != _ENCAPSULATION or len(data) < 8:
        raise ValueError("std_msgs/msg/String: encapsulation is not that of plain CDR, little endian")
    (length,) = struct.unpack_from("<I", data, 4)
    text = data[8 : 8 + length]
    if not text.endswith(b"\0") or len(text) != length:
        raise ValueError("std_msgs/msg/String: the text is cut off")
    return text[:-1].decode()


def _fields(names: str, kind: str = "float64") -> dict[str, str]:
    """Return the declaration of fields of one type."""
    return dict.fromkeys(names.split(), kind)


MEASUREMENT: Final = Layout(
    "gyrowheel_msgs/msg/Measurement",
    {**_HEADER, "sequence": "uint64"}
    | _fields("tilt_x tilt_y spin_angle spin_rate coil_voltage_x coil_voltage_y motor_voltage motor_current")
    | _fields("coil_temperature air_temperature air_pressure"),
)
COMMAND: Final = Layout(
    "gyrowheel_msgs/msg/Command",
    {**_HEADER, "measurement_sequence": "uint64"} | _fields("coil_voltage_x coil_voltage_y motor_voltage"),
)
SETPOINT: Final = Layout(
    "gyrowheel_msgs/msg/Setpoint",
    {**_HEADER, "segment": "uint32", "phase": "uint8"}
    | _fields("tilt_x tilt_y tilt_rate_x tilt_rate_y spin_rate spin_acceleration"),
)
DRAG_ESTIMATE: Final = Layout(
    "gyrowheel_msgs/msg/DragEstimate",
    {**_HEADER, "segment": "uint32", "settled": "bool"}
    | _fields("duration tilt_x tilt_y spin_rate")
    | _fields("dc_voltage dc_voltage_std", "float64[3]")
    | _fields("motor_current motor_current_std")
    | {"reference_segment": "uint32"}
    | _fields("voltage_increment voltage_increment_std simulated_voltage_increment", "float64[3]")
    | {"calibrated": "bool"}
    | _fields("measured_torque measured_torque_std constants_std simulated_torque", "float64[3]")
    | _fields("simulated_air_torque residual", "float64[3]"),
)
CLOCK: Final = Layout("rosgraph_msgs/msg/Clock", _TIME)
