"""Message definitions, and serialized messages as numpy columns."""

from __future__ import annotations

import functools
import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from gyrowheel_core import wire
from gyrowheel_core.arrays import everywhere, gathered, zeros
from gyrowheel_core.errors import InputError, one_line
from gyrowheel_core.wire import Layout
from gyrowheel_recording.bags.mcap.batches import TopicData, Want, joined

_PACKAGE = "gyrowheel_msgs"


@dataclass(frozen=True)
class Definition:
    """Definition of one message type."""

    text: str  # its ``.msg`` file, followed by those of the types it contains (schema encoding ``ros2msg``)
    type_hash: str  # its ROS 2 type hash, ``RIHS01_...``


@functools.cache
def definition(type_name: str) -> Definition:
    """Return the definition of a message type of ROS 2 Jazzy or of gyrowheel_msgs.

    Raises
    ------
    InputError
        If the type is unknown, or gyrowheel_msgs is not installed.
    """
    store = typestore()
    if type_name not in store.fielddefs:
        files = "" if _message_files() else f" ({_PACKAGE} is not installed)"
        raise InputError(f"message type '{type_name}': unknown{files}")
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    own = _message_files().get(type_name)
    if own is not None:  # the file has comments with the units; the types it contains come from the store
        _, separator, rest = text.partition(_SEPARATOR)
        text = own.read_text(encoding="utf-8") + separator + rest
    return Definition(text, store.hash_rihs01(type_name))


def typestore() -> Typestore:
    """Return a new store of the types of ROS 2 Jazzy and, where it is installed, of gyrowheel_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, file in _message_files().items():
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), name))
    return store


@functools.cache
def _message_files() -> dict[str, Path]:
    """Return the installed ``.msg`` files of gyrowheel_msgs by type name.

    Both colcon and pip install them in ``share`` of a prefix. They need not be compiled.
    """
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    for prefix in prefixes:
        files = sorted(Path(prefix, "share", _PACKAGE, "msg").glob("*.msg"))
        if files:
            return {f"{_PACKAGE}/msg/{file.stem}": file for file in files}
    return {}


_SEPARATOR = "=" * 80 + "\n"
#: Characters of a definition; the parser takes seconds for as many, and no type has a tenth of them.
_LONGEST_DEFINITION = 200_000
#: Elements of arrays of texts or messages in a definition; rosbags makes code for each of them.
_MOST_ELEMENTS = 10_000
#: Types within types; brackets within brackets, which the parser of IDL reads twice or more at each of them.
_DEEPEST_TYPE, _DEEPEST_BRACKET = 50, 2
#: Texts and comments in IDL, as rosbags reads it.
_NO_CODE = re.compile(r'"(?:\\"|[^"])*"|//[^\n]*|/\*.*?(?:\*/|\Z)', re.DOTALL)
_LONGEST_TEXT = 1_000_000  # bytes of a description of bench or environment
_LONGEST_SAID = 200  # characters of the message of a parser

#: A step of the stamps beyond this many periods, where no sample is missing, is no jitter: the bench stood still.
STALL = 5.0


@functools.cache
def column_dtype(layout: Layout) -> np.dtype[Any]:
    """Return the dtype of columns: ``stamp_ns`` and the fields of a message after its header."""
    names = [*layout.integers, *layout.fields]
    return np.dtype([("stamp_ns", np.int64), *((name, layout.dtype[name]) for name in names)], align=True)


def wanted(layout: Layout) -> Want:
    """Return how to read a topic whose messages should have a layout, for `columns`.

    Messages of the layout are copied as they are; others (another frame_id, byte order or further fields) are left
    for `columns` to decode.
    """

    def fits(topic: TopicData) -> bool:
        try:
            return _declares(topic, layout, topic.name)
        except InputError:  # the checksums come first, they may show why; `columns` raises it again
            return False

    def take(
        records: memoryview, begins: npt.NDArray[np.int64], rows: npt.NDArray[Any], compiled: bool
    ) -> bool:
        if compiled:
            return _copied(records, begins, rows, layout)
        messages = gathered(records, begins, layout.dtype)
        if not layout.matches(messages).all():
            return False
        _put(messages, rows, layout)
        return True

    return Want(layout.dtype, column_dtype(layout), fits, take)


def columns(topic: TopicData | None, layout: Layout, where: str) -> npt.NDArray[Any]:
    """Return the messages of a topic, shape (n,), as columns; messages of another layout are decoded one by one.

    They are in the order of the file, dtype `column_dtype`. The messages of `topic` (None: not recorded) are
    released.

    Raises
    ------
    InputError
        If messages lack a field of the layout or cannot be decoded; it names `where`.
    """
    dtype = column_dtype(layout)
    if topic is None or topic.count == 0:
        return np.zeros(0, dtype)
    where = f"{where}: {topic.name}"
    if topic.message_encoding != "cdr":
        raise InputError(f"{where}: messages are encoded as {topic.message_encoding!r}; only cdr is known")
    pieces, topic.pieces = topic.pieces[::-1], []
    if not any(isinstance(piece, list) for piece in pieces) and (whole := joined(pieces[::-1])) is not None:  # type: ignore[arg-type]
        return whole
    result = zeros(topic.count, dtype)
    decode = None
    k = 0
    while pieces:
        piece = pieces.pop()  # so that the data are never in memory twice
        if isinstance(piece, list):
            decode = decode or _decoder(topic, layout, where)
            piece = decode(piece, k)
        result[k : k + len(piece)] = piece
        k += len(piece)
    return result


def _put(messages: npt.NDArray[Any], rows: npt.NDArray[Any], layout: Layout) -> None:
    """Write messages of a layout into rows."""
    rows["stamp_ns"] = layout.stamps(messages)
    source, target = _as_runs(layout)
    messages, rows = messages.view(source), rows.view(target)
    for name in source.names or ():
        rows[name] = messages[name]


def _rows(messages: npt.NDArray[Any], layout: Layout) -> npt.NDArray[Any]:
    rows = np.zeros(len(messages), column_dtype(layout))  # copies are compared as bytes, padding included
    _put(messages, rows, layout)
    return rows


def _copied(
    records: memoryview, begins: npt.NDArray[np.int64], rows: npt.NDArray[Any], layout: Layout
) -> bool:
    """Write messages of a layout into rows by a compiled loop; return False if they are not of it."""
    from gyrowheel_recording.bags.mcap.loops import copied

    stamps, constants, runs, stamp_at = _places(layout)
    target = rows.view(np.uint8).data
    as_bytes, as_words = np.dtype(np.uint8), np.dtype(np.uint64)
    return bool(
        copied(
            (everywhere(records, as_bytes), everywhere(records, as_words)),
            everywhere(records, stamps),
            begins,
            constants,
            runs,
            stamp_at,
            (everywhere(target, as_bytes, writeable=True), everywhere(target, as_words, writeable=True)),
        )
    )


@functools.cache
def _places(layout: Layout) -> tuple[np.dtype[Any], npt.NDArray[np.uint64], npt.NDArray[np.int64], int]:
    """Return how a loop copies messages: the stamp as a dtype, `_constants`, the `_runs`, place of the stamp."""
    fields: Mapping[str, Any] = layout.dtype.fields or {}
    names = ("sec", "nanosec")
    stamp = np.dtype(
        {"names": names, "formats": [fields[n][0] for n in names], "offsets": [fields[n][1] for n in names]}
    )
    rows: Mapping[str, Any] = column_dtype(layout).fields or {}
    runs = np.array(_runs(layout), dtype=np.int64).reshape(-1, 3)
    return stamp, _constants(layout), runs, rows["stamp_ns"][1]


def _constants(layout: Layout) -> npt.NDArray[np.uint64]:
    """Return the constant bytes of a layout as words of a message: place, bits that are constant, and these bits."""
    size = layout.dtype.itemsize
    left = dict(layout.constant_bytes.tolist())
    words = []
    while left:
        place = min(min(left), size - 8)
        own = [(k, left.pop(place + k)) for k in range(8) if place + k in left]
        words.append((place, sum(0xFF << 8 * k for k, _ in own), sum(byte << 8 * k for k, byte in own)))
    return np.array(words, dtype=np.uint64).reshape(-1, 3)


@functools.cache
def _runs(layout: Layout) -> list[tuple[int, int, int]]:
    """Return place in a message and in a row, and bytes of fields that follow one another in both."""
    message, row = layout.dtype, column_dtype(layout)
    runs: list[tuple[int, int, int]] = []
    for name in (*layout.integers, *layout.fields):
        (kind, here), (_, there) = (dtype.fields[name][:2] for dtype in (message, row) if dtype.fields)
        last = runs[-1] if runs else (0, 0, -1)
        if (here, there) == (last[0] + last[2], last[1] + last[2]):
            runs[-1] = (last[0], last[1], last[2] + kind.itemsize)
        else:
            runs.append((here, there, kind.itemsize))
    return runs


@functools.cache
def _as_runs(layout: Layout) -> tuple[np.dtype[Any], np.dtype[Any]]:
    """Return a message and a row as dtypes of plain bytes, a field for each of their `_runs`."""
    runs = _runs(layout)

    def dtype(places: list[int], size: int) -> np.dtype[Any]:
        return np.dtype(
            {
                "names": [f"run{k}" for k in range(len(runs))],
                "formats": [f"V{length}" for _, _, length in runs],
                "offsets": places,
                "itemsize": size,
            }
        )

    return (
        dtype([here for here, _, _ in runs], layout.dtype.itemsize),
        dtype([there for _, there, _ in runs], column_dtype(layout).itemsize),
    )


def texts(topic: TopicData | None, where: str) -> list[str]:
    """Return the messages of a topic of std_msgs/String.

    Raises
    ------
    InputError
        If they are of another type, far longer than any, or damaged.
    """
    if topic is None:
        return []
    if topic.type_name != "std_msgs/msg/String":
        raise InputError(f"{where}: {topic.name}: type {topic.type_name}; std_msgs/msg/String is expected")
    messages = [message for piece in topic.pieces if isinstance(piece, list) for message in piece]
    longest = max(map(len, messages), default=0)
    if longest > _LONGEST_TEXT:
        raise InputError(f"{where}: {topic.name}: a text of {longest} bytes; allowed: up to {_LONGEST_TEXT}")
    try:
        return [wire.unpack_text(message) for message in messages]
    except ValueError as error:
        raise InputError(f"{where}: {topic.name}: {error}") from None


def _declares(topic: TopicData, layout: Layout, where: str) -> bool:
    """Whether the messages of a topic are declared to have a layout."""
    if topic.message_encoding != "cdr":
        return False
    if topic.definition:
        declared = _declared(topic.type_name, topic.definition_encoding, topic.definition, where)
        return [*declared.items()] == [*layout.declaration.items()]
    return topic.type_name == layout.type_name


def is_earlier(topic: TopicData | None, layout: Layout, where: str) -> bool:
    """Whether a topic has an earlier version of a type, which lacks fields of the layout.

    Raises InputError if the definition of the type cannot be read; it names `where`.
    """
    if topic is None or topic.type_name != layout.type_name or not topic.definition:
        return False
    where = f"{where}: {topic.name}"
    declared = _declared(topic.type_name, topic.definition_encoding, topic.definition, where)
    return bool(declared) and not set(layout.names) <= declared.keys()


def _decoder(topic: TopicData, layout: Layout, where: str) -> Callable[[list[bytes], int], npt.NDArray[Any]]:
    """Return a function that decodes messages by the definition of their topic, given the number of the first."""
    store = checked_store(topic, where)
    names = (*layout.integers, *layout.fields)

    def decode(messages: list[bytes], first: int) -> npt.NDArray[Any]:
        result = layout.array(len(messages))
        for k, message in enumerate(messages):
            try:
                decoded: Any = store.deserialize_cdr(message, topic.type_name)
            except Exception as error:  # on bad data rosbags passes on whatever its generated code raises
                raise InputError(
                    f"{where}: message {first + k} cannot be decoded ({one_line(error)})"
                ) from None
            try:
                stamp = decoded.header.stamp
                layout.set_stamps(result[k : k + 1], stamp.sec * wire.SECOND + stamp.nanosec)
                for name in names:
                    result[name][k] = getattr(decoded, name)
            except (AttributeError, TypeError, ValueError, OverflowError) as error:
                raise InputError(
                    f"{where}: messages of type {topic.type_name} do not have the fields of"
                    f" {layout.type_name} ({error})"
                ) from None
        return _rows(result, layout)

    return decode


@functools.lru_cache(maxsize=64)
def _declared(type_name: str, encoding: str, definition: str, where: str) -> dict[str, str]:
    """Return the fields that a definition declares, or None; cached, because parsing may take longer than reading."""
    topic = TopicData(where, type_name, "cdr", encoding, definition)
    return _declaration(_types(topic, where), type_name) or {}


def _types(topic: TopicData, where: str) -> Typesdict:
    """Return the types that the definition of a topic declares, if they are such as a recording may have.

    rosbags parses by trial and error and makes code of the types. What would take it minutes or the memory is
    refused.
    """
    what = f"{where}: the definition of {topic.type_name}"
    if len(topic.definition) > _LONGEST_DEFINITION:
        raise InputError(
            f"{what} has {len(topic.definition)} characters; allowed: up to {_LONGEST_DEFINITION}"
        )
    try:
        if topic.definition_encoding == "ros2msg":
            types = get_types_from_msg(topic.definition, topic.type_name)
        elif topic.definition_encoding == "ros2idl":
            types = _types_from_idl(topic.definition, what)
        else:
            raise InputError(f"{where}: message definition of encoding {topic.definition_encoding!r}")
    except InputError:
        raise
    except Exception as error:  # on damaged text rosbags passes on whatever its parser raises
        raise InputError(f"{what} cannot be read ({one_line(error)[:_LONGEST_SAID]})") from None
    elements = sum(_elements(field) for _, fields in types.values() for _, field in fields)
    if elements > _MOST_ELEMENTS:
        raise InputError(f"{what} has arrays of {elements} elements; allowed: up to {_MOST_ELEMENTS}")
    return types


def _types_from_idl(definition: str, what: str) -> Typesdict:
    code = _NO_CODE.sub(" ", definition)
    if "<<" in code or max(_depth(code, "()"), _depth(code, "<>")) > _DEEPEST_BRACKET:
        raise InputError(
            f"{what} cannot be read: unsupported type definition (expressions, or nested brackets)"
        )
    types: Typesdict = {}
    parts = definition.split(_SEPARATOR)
    for part in parts[1:] if len(parts) > 1 else parts:
        types.update(get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part))
    return types


def _depth(text: str, brackets: str) -> int:
    """Return the deepest nesting of these brackets; unmatched closing ones do not count."""
    deepest = depth = 0
    for sign in text:
        if sign == brackets[0]:
            depth += 1
            deepest = max(deepest, depth)
        elif sign == brackets[1]:
            depth = max(depth - 1, 0)
    return deepest


def _elements(field: FieldDesc) -> int:
    """Return the number of elements of an array for which code is generated; numbers are read all at once."""
    if field[0] != Nodetype.ARRAY:
        return 0
    element, count = field[1]
    return 0 if element[0] == Nodetype.BASE and element[1][0] != "string" else max(count, 0)


def checked_store(topic: TopicData, where: str) -> Typestore:
    """Return a store that knows the type of a topic."""
    store = get_typestore(Stores.EMPTY) if topic.definition else typestore()
    if topic.definition:
        try:
            store.register(_types(topic, where))
        except InputError:
            raise
        except Exception as error:  # it declares a type of ROS otherwise, or what is no name in Python
            raise InputError(
                f"{where}: the definition of {topic.type_name} cannot be read"
                f" ({one_line(error)[:_LONGEST_SAID]})"
            ) from None
    if topic.type_name not in store.fielddefs:
        raise InputError(
            f"{where}: the recording has no definition of {topic.type_name}, and none is installed"
        )
    return store


def _declaration(types: Typesdict, type_name: str, depth: int = 0) -> dict[str, str] | None:
    """Return the fields of a type as a layout declares them, flattened; None if a layout cannot declare one of them."""
    if depth > _DEEPEST_TYPE:  # it contains itself
        return None
    result: dict[str, str] = {}
    for name, description in types[type_name][1] if type_name in types else ():
        kind = _kind(description)
        if kind is not None:
            result[name] = kind
            continue
        inner = _declaration(types, description[1], depth + 1) if isinstance(description[1], str) else None
        if inner is None or inner.keys() & result.keys():
            return None
        result |= inner
    return result or None


def _kind(description: FieldDesc) -> str | None:
    """Return a primitive type, or an array of three of it, as text; None for another type."""
    if description[0] == Nodetype.BASE:
        return str(description[1][0])
    if description[0] == Nodetype.ARRAY and description[1][1] == 3 and description[1][0][0] == Nodetype.BASE:
        return f"{description[1][0][1][0]}[3]"
    return None
