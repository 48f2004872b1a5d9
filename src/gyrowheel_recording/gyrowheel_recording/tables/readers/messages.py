"""Messages of ROS as columns: every number in them by its place, and their stamps.

Messages of rosbags and of rclpy are read alike.
"""

from __future__ import annotations

import functools
import operator
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields as fields_of
from typing import Any, Final

import numpy as np

from gyrowheel_core.errors import InputError
from gyrowheel_recording.tables.grid import Column

_MOST: Final = 256  # elements of an array that become columns
_DEEPEST: Final = 8  # messages within lists within messages
_STAMP: Final = "stamp"
_BLOCK: Final = 4096  # values that are numbers of Python before they are an array
_FEW: Final = (
    0.01  # of the messages of a topic: those of a frame that is met so seldom are no instrument of their own
)
_FAR: Final = 60_000_000_000  # ns; stamps so far from the time of logging are of another clock
#: Fields by which messages in a list are told apart.
_IDENTITIES: Final = ("name", "child_frame_id", "id", "key", "joint_name")

Pick = Callable[[Any], Any]


class _Values:
    """Numbers that are appended one by one."""

    def __init__(self, missing: int) -> None:
        self._done = [np.full(missing, np.nan)] if missing else []
        self._rest: list[Any] = []

    def append(self, value: Any) -> None:
        """Append one."""
        self._rest.append(value)
        if len(self._rest) >= _BLOCK:
            self._done.append(np.asarray(self._rest))
            self._rest = []

    def array(self) -> Any:
        """Return all of them."""
        if self._rest:
            self._done.append(np.asarray(self._rest))
            self._rest = []
        return np.concatenate(self._done) if self._done else np.zeros(0)


class TopicColumns:
    """The messages of a topic, those of one frame, as far as they were read."""

    def __init__(self, wanted: frozenset[str] | None) -> None:
        self._wanted = wanted
        self.count = 0  # how many
        self.stamps, self.logged = (
            _Values(0),
            _Values(0),
        )  # their stamps, 0 without one, and when they came [ns]
        #: How the numbers in them are taken out, by their places.
        self.parts: dict[str, Pick] = {}
        self.values: dict[str, _Values] = {}  # the numbers; NaN in messages that do not have one
        self.seen: set[Any] = set()  # shapes of messages that were met
        self.unread: dict[str, str] = {}  # what in them is no column, and why
        self._varies: bool | None = None

    def add(self, message: Any, logged: int) -> int:
        """Add a message that was logged at a time [ns]; return how many numbers that are."""
        before = len(self.parts)
        if self._varies is None:
            self._varies = _varies(message)
        shape = _shape(message) if self._varies else ()
        if shape not in self.seen:
            self.seen.add(shape)
            for place, pick in _numbers(message, "", self.unread):
                if place not in self.parts and (self._wanted is None or place in self._wanted):
                    self.parts[place] = pick
                    self.values[place] = _Values(self.count)
        self.stamps.append(stamp_of(message))
        self.logged.append(logged)
        for place, pick in self.parts.items():
            self.values[place].append(pick(message))
        self.count += 1
        return 2 + len(self.parts) + (len(self.parts) - before) * self.count


def frame_of(message: Any) -> str:
    """Return the frame of a message; empty where it states none."""
    return str(getattr(getattr(message, "header", None), "frame_id", ""))


def wanted_fields(topic: str, frame: str, names: Sequence[str] | None) -> frozenset[str] | None:
    """Return the places in the messages of a topic that are wanted; None for all."""
    if names is None:
        return None
    heads = (f"{topic}.", f"{topic}@{frame}.")
    return frozenset(name[len(head) - 1 :] for name in names for head in heads if name.startswith(head))


def columns_of(
    topics: Mapping[str, Mapping[str, TopicColumns]], names: Sequence[str] | None, remarks: list[str]
) -> list[Column]:
    """Return the messages of all topics, by their frames, as columns.

    Topics with equal stamps share one clock. Raises InputError if a column that is wanted is of several frames.
    """
    parts = _parts(topics, names, remarks)
    times, kept = _times(parts, remarks if names is None else [])
    begin = min((int(own[kept[name]].min()) for name, own in times.items()), default=0)
    columns: list[Column] = []
    clocks: dict[bytes, str] = {}
    wanted = set(names or ())
    for name in sorted(parts, key=lambda own: f"{own}.{_STAMP}" not in wanted):
        rows = kept[name]
        stamps = times[name][rows] - begin
        clock = clocks.setdefault(stamps.tobytes(), f"{name}.{_STAMP}")
        if clock == f"{name}.{_STAMP}" or f"{name}.{_STAMP}" in wanted:
            own_clock = f"{name}.{_STAMP}"
            columns.append(Column(own_clock, stamps * 1e-9, "s", own_clock))
        columns += [
            Column(f"{name}{place}", values.array()[rows], "", clock)
            for place, values in parts[name].values.items()
        ]
    return columns


def _parts(
    topics: Mapping[str, Mapping[str, TopicColumns]], names: Sequence[str] | None, remarks: list[str]
) -> dict[str, TopicColumns]:
    """Return the messages of every topic, of one that has several frames by frame, by names of columns."""
    parts: dict[str, TopicColumns] = {}
    for topic, frames in topics.items():
        every = sum(own.count for own in frames.values())
        several = [frame for frame, own in frames.items() if own.count > max(_FEW * every, 1)]
        if names is None and not any(own.parts for own in frames.values()):
            several = []
        if len(several) > 1 and names is not None and any(name.startswith(f"{topic}.") for name in names):
            allowed = ", ".join(f"{topic}@{frame}" for frame in several)
            raise InputError(f"{topic}: its messages are of {len(several)} frames; allowed: {allowed}")
        if len(several) > 1:
            parts |= {f"{topic}@{frame}": frames[frame] for frame in several}
        elif frames:
            parts[topic] = max(frames.values(), key=lambda own: (bool(own.parts), own.count))
        if names is None:
            told = {place: why for own in frames.values() for place, why in own.unread.items()}
            remarks += [f"{topic}{place} is left out: {why}" for place, why in told.items()]
    return {name: own for name, own in parts.items() if own.count and (names is not None or own.parts)}


def _times(parts: Mapping[str, TopicColumns], remarks: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the times of the messages of every topic [ns], and which messages to take in which order.

    They are stamps, or times of logging where there are none. Where stamps are of another clock than that of logging,
    as the time since a controller was switched on, and some topics have no stamps, the stamps are moved.
    """
    times, kept, late = {}, {}, {}
    for name, own in parts.items():
        stamps, logged = own.stamps.array().astype(np.int64), own.logged.array().astype(np.int64)
        stamped = stamps != 0
        rows = np.argsort(logged, kind="stable")
        if not stamped.any():
            times[name], kept[name] = logged, rows
            continue
        if not stamped.all():
            remarks.append(
                f"{name}: {np.count_nonzero(~stamped)} messages have the stamp 0, as before there was a clock: "
                "they are left out"
            )
        times[name], kept[name] = stamps, rows[stamped[rows]]
        late[name] = int(np.min((logged - stamps)[stamped]))
    far = {name: own for name, own in late.items() if abs(own) > _FAR}
    if far and len(far) < len(parts):
        for name, apart in far.items():
            # one clock has one offset: that of the message that came fastest
            offset = min(other for other in far.values() if abs(other - apart) < _FAR)
            times[name] = times[name] + offset
            remarks.append(
                f"{name}: its stamps are {1e-9 * offset:.6f} s behind the time of logging, by which others are "
                "known: that is added, but for the delay of its fastest message, which is not known"
            )
    return times, kept


def stamp_of(message: Any) -> int:
    """Return the stamp of a message [ns], in its header or without one; 0 if there is no stamp."""
    for holder in (getattr(message, "header", None), message):
        stamp = getattr(holder, _STAMP, None)
        if stamp is not None and hasattr(stamp, "sec") and hasattr(stamp, "nanosec"):
            return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return 0


def _is_message(value: Any) -> bool:
    return hasattr(value, "__dataclass_fields__") or hasattr(value, "get_fields_and_field_types")


def _fields(message: Any) -> list[str]:
    """Return the names of the fields of a message, without constants."""
    if hasattr(message, "__dataclass_fields__"):
        return [own.name for own in fields_of(message) if own.name != "__msgtype__"]
    return list(message.get_fields_and_field_types())


def _value(message: Any, name: str) -> Any:
    """Return a field of a message, lists of numbers as an array."""
    value = getattr(message, name)
    return np.asarray(value) if isinstance(value, array) else value


def _varies(message: Any, depth: int = 0) -> bool:
    """Whether messages like one may have other elements, or other names of elements."""
    for own in _fields(message):
        value = _value(message, own)
        if isinstance(value, list) or (isinstance(value, np.ndarray) and depth < _DEEPEST):
            return True
        if _is_message(value) and depth < _DEEPEST and _varies(value, depth + 1):
            return True
    return False


def _shape(message: Any) -> Any:
    """Return what the places of the numbers in a message depend on: names of its elements, and how many there are."""
    found: list[Any] = []
    for name in _fields(message):
        value = _value(message, name)
        if isinstance(value, list):
            found.append(tuple(own if isinstance(own, str) else _shape_of(own) for own in value[:_MOST]))
        elif isinstance(value, np.ndarray):
            found.append(value.size)
        elif _is_message(value) and name != "header":
            found.append(_shape(value))
    return tuple(found)


def _shape_of(item: Any) -> Any:
    return (_identity(item), _shape(item)) if _is_message(item) else ()


def _identity(item: Any) -> str:
    """Return what a message in a list is called by itself; empty where it is not."""
    for name in _IDENTITIES:
        value = getattr(item, name, None)
        if isinstance(value, str) and value:
            return value
    return ""


def _labels(message: Any) -> tuple[str, tuple[str, ...]]:
    """Return the field with the names that a message gives to its elements, as those of joints, and the names."""
    for own in _fields(message):
        if own in ("name", "names") or own.endswith("_names"):
            names = getattr(message, own)
            named = isinstance(names, list) and all(isinstance(label, str) and label for label in names)
            if named and names and len(set(names)) == len(names):
                return own, tuple(names)
    return "", ()


def _numbers(message: Any, place: str, unread: dict[str, str], depth: int = 0) -> list[tuple[str, Pick]]:
    """Return the numbers in a message: their places, and how they are taken out of another one like it.

    What is left out is added to `unread` with the reason.
    """
    found: list[tuple[str, Pick]] = []
    field, labels = _labels(message)
    for own in _fields(message):
        if own == "header" and not place:
            continue
        value, where = _value(message, own), f"{place}.{own}"
        if isinstance(value, bool | int | float | np.number):
            found.append((where, operator.attrgetter(own)))
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            if value.size > _MOST:
                unread[where] = f"{value.size} elements; allowed: up to {_MOST}"
            elif len(labels) == value.size and labels:
                # names of interfaces stand for the list of their values
                inner = place if field not in ("name", "names") else where
                found += [
                    (f"{inner}.{label}", functools.partial(_labelled, own, field, label)) for label in labels
                ]
            else:
                found += [(f"{where}.{k}", functools.partial(_element, own, k)) for k in range(value.size)]
        elif _is_message(value):
            found += [
                (inner, functools.partial(_within, own, take))
                for inner, take in _numbers(value, where, unread, depth + 1)
            ]
        elif isinstance(value, list) and value and _is_message(value[0]):
            found += _listed(value, own, (place, where), (field, labels), unread, depth)
    return found


def _listed(
    items: Sequence[Any],
    own: str,
    places: tuple[str, str],
    named: tuple[str, tuple[str, ...]],
    unread: dict[str, str],
    depth: int,
) -> list[tuple[str, Pick]]:
    """Return the numbers in the messages of a list, by the names of these where they have any."""
    (place, where), (field, labels) = places, named
    if len(items) > _MOST or depth >= _DEEPEST:
        unread[where] = f"a list of {len(items)} messages; allowed: up to {_MOST}"
        return []
    found: list[tuple[str, Pick]] = []
    identities = [_identity(item) for item in items]
    for k, item in enumerate(items):
        if len(labels) == len(items):
            inner, pick = f"{place}.{labels[k]}", functools.partial(_item_labelled, own, field, labels[k])
        elif all(identities) and len(set(identities)) == len(items):
            inner, pick = f"{where}.{identities[k]}", functools.partial(_item_called, own, identities[k])
        else:
            inner, pick = f"{where}.{k}", functools.partial(_item, own, k)
        found += [
            (deeper, functools.partial(_of_item, pick, take))
            for deeper, take in _numbers(item, inner, unread, depth + 1)
        ]
    return found


def numbers_in(message: Any) -> dict[str, Pick]:
    """Return how each number of a message is taken out of another one like it, by its place such as ``.field.0``."""
    return dict(_numbers(message, "", {}))


def _within(name: str, take: Pick, message: Any) -> Any:
    return take(getattr(message, name))


def _of_item(pick: Pick, take: Pick, message: Any) -> Any:
    """Return a number in a message of a list, NaN where there is no such message."""
    item = pick(message)
    return np.nan if item is None else take(item)


def _item(name: str, k: int, message: Any) -> Any:
    items = getattr(message, name)
    return items[k] if k < len(items) else None


def _item_called(name: str, identity: str, message: Any) -> Any:
    return next((item for item in getattr(message, name) if _identity(item) == identity), None)


def _item_labelled(name: str, field: str, label: str, message: Any) -> Any:
    items, labels = getattr(message, name), getattr(message, field)
    return items[labels.index(label)] if label in labels and len(items) == len(labels) else None


def _element(name: str, k: int, message: Any) -> Any:
    """Return an element of an array in a message, NaN where it is shorter than the first one was."""
    flat = _value(message, name).ravel()
    return flat[k] if k < len(flat) else np.nan


def _labelled(name: str, field: str, label: str, message: Any) -> Any:
    """Return the element of an array that a message calls so, NaN where it has none."""
    flat, labels = _value(message, name).ravel(), getattr(message, field)
    return flat[labels.index(label)] if label in labels and len(flat) == len(labels) else np.nan
