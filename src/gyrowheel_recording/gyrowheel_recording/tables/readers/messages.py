"""Messages of bags by the types that the bags declare, none of which grows beyond what it holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.typesys.store import Typestore

from gyrowheel_core.errors import InputError
from gyrowheel_core.limits import require_room
from gyrowheel_recording.bags.columns import checked_store
from gyrowheel_recording.bags.mcap.topics import TopicData

_OBJECT: Final = 200  # bytes of a message within another, of one byte
_MOST_DEFINED: Final = (
    4_000_000  # characters of all definitions that are read; the parser takes a minute for them
)
#: Messages within a message beside its lists, and such of them as have nothing in them.
_MOST_OBJECTS, _MOST_EMPTY = 100_000, 1000
_DEEPEST: Final = 50
_NOTHING: Final = "structure_needs_at_least_one_member"  # the field of an empty type, which is not looked at
_BYTES: Final = ("uint8", "int8", "byte", "char")
_NO_DIGEST: Final = ("", "*")


class Decoders:
    """What makes objects of messages.

    Parameters
    ----------
    where : str
        The bag.
    ros1 : bool
        Whether messages are serialized as ROS 1 does it.
    """

    def __init__(self, where: str, *, ros1: bool) -> None:
        self._where, self._ros1 = where, ros1
        self._left = _MOST_DEFINED
        self._known: dict[tuple[str, str, str], Callable[[bytes], Any]] = {}

    def of(self, topic: TopicData, digest: str = "") -> Callable[[bytes], Any]:
        """Return what makes objects of the messages of a topic, whose definition has a checksum or none.

        Raises
        ------
        InputError
            If their type cannot be read; so does what is returned, if a message cannot.
        """
        key = topic.type_name, topic.definition, digest
        if key not in self._known:
            self._known[key] = self._new(topic, digest)
        return self._known[key]

    def _new(self, topic: TopicData, digest: str) -> Callable[[bytes], Any]:
        where, kind = f"{self._where}: {topic.name}", topic.type_name
        self._left -= len(topic.definition)
        if self._left < 0:
            raise InputError(f"{self._where}: definitions of types of more than {_MOST_DEFINED} characters")
        store = checked_store(topic, where)
        what = f"{where}: the definition of {kind}"
        size = _size(store, kind, what)
        if size.objects > _MOST_OBJECTS or size.empty > _MOST_EMPTY:
            raise InputError(
                f"{what} has {size.objects:.3g} messages within it, {size.empty:.3g} of them empty"
            )
        take = store.deserialize_ros1 if self._ros1 else store.deserialize_cdr
        try:
            store.get_msgdef(kind)
            own = store.generate_msgdef(kind)[1] if digest not in _NO_DIGEST else digest
        except Exception:  # rosbags makes code of it, for which names or sizes may not do
            raise InputError(f"{what} cannot be read") from None
        if own != digest:
            raise InputError(f"{what} is damaged: its checksum is {own}, not {digest[:40]}")

        def decode(message: bytes) -> Any:
            if size.lists:
                require_room(_OBJECT * float(len(message)), f"{where}: a message")
            return take(message, kind)

        return decode

    def has_lists_of_bytes(self, topic: TopicData) -> bool:
        """Whether messages of a topic have lists of bytes, as pictures and clouds of points do."""
        try:
            store = checked_store(topic, self._where)
        except InputError:
            return False
        lists = [
            field[1][0] for _, field in store.fielddefs[topic.type_name][1] if field[0] == Nodetype.SEQUENCE
        ]
        return any(own[0] == Nodetype.BASE and own[1][0] in _BYTES for own in lists)


class _Size(NamedTuple):
    """What a message takes at least: bytes, objects, those of them without a byte; and whether it has lists of some."""

    size: int = 0
    objects: float = 0.0
    empty: float = 0.0
    lists: bool = False

    def __add__(self, other: _Size) -> _Size:  # type: ignore[override]
        return _Size(
            self.size + other.size,
            self.objects + other.objects,
            self.empty + other.empty,
            self.lists or other.lists,
        )


def _size(store: Typestore, kind: str, what: str) -> _Size:
    """Return what a message of a type takes at least.

    Raises
    ------
    InputError
        If the type contains itself, or lists of what has no bytes: those are as long as a message says.
    """
    known: dict[str, _Size] = {}

    def of_type(name: str, depth: int) -> _Size:
        if name in known:
            return known[name]
        if name not in store.fielddefs:
            raise InputError(f"{what} lacks that of {name}")
        if depth > _DEEPEST:
            raise InputError(f"{what} contains itself, or types more than {_DEEPEST} deep")
        stored = [field for own, field in store.fielddefs[name][1] if own != _NOTHING]
        own = sum((of_field(field, depth + 1) for field in stored), _Size(objects=1.0))
        known[name] = own if own.size else own._replace(empty=own.objects)
        return known[name]

    def of_field(field: FieldDesc, depth: int) -> _Size:
        if field[0] == Nodetype.BASE:
            return _Size(1)
        if field[0] == Nodetype.NAME:
            return of_type(field[1], depth)
        element, count = field[1]
        own = of_field(element, depth)
        several = own.lists or element[0] == Nodetype.NAME or element[1][0] == "string"
        if field[0] == Nodetype.ARRAY:
            return _Size(own.size * count, own.objects * count, own.empty * count, several)
        if not own.size or own.empty:
            raise InputError(f"{what} has lists of messages without anything in them")
        return _Size(4, 0.0, 0.0, several)

    return of_type(kind, 0)
