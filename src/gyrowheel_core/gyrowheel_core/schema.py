"""Checks of users' files against a schema; an error is one line that names file, field and value."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Final, NamedTuple, NoReturn, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from gyrowheel_core.errors import InputError, nearest, one_line

_LONGEST: Final = 60  # characters of a value that a message repeats
#: Messages by the type of pydantic's error; other types keep pydantic's message.
_SAID: Final = {
    "missing": "missing",
    "extra_forbidden": "no such field",
    "literal_error": "{} is not known",
    "const_error": "{} is not known",
    "enum": "{} is not known",
    "float_type": "{} is not a number",
    "float_parsing": "{} is not a number",
    "finite_number": "{} is not finite",
    "int_type": "{} is not a whole number",
    "int_parsing": "{} is not a whole number",
    "int_parsing_size": "{} is too large",
    "int_from_float": "{} is not a whole number",
    "bool_type": "{} is neither true nor false",
    "bool_parsing": "{} is neither true nor false",
    "string_type": "{} is not a text",
    "string_too_short": "{} is too short",
    "string_too_long": "{} is too long",
    "string_pattern_mismatch": "{} is not allowed",
    "list_type": "{} is not a list",
    "tuple_type": "{} is not a list",
    "too_short": "{} is too short",
    "too_long": "{} is too long",
    "dict_type": "{} is not a mapping",
    "model_type": "{} is not a mapping",
    "model_attributes_type": "{} is not a mapping",
    "greater_than": "{} is out of range",
    "greater_than_equal": "{} is out of range",
    "less_than": "{} is out of range",
    "less_than_equal": "{} is out of range",
}
_MOST_TOLD: Final = 12  # of what is wrong, in one line
_OWN: Final = "refused"  # type of the errors of `refuse`


class Section(BaseModel):
    """A mapping in a user's file: unknown keys are refused, and its values are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Problem(NamedTuple):
    """An error in one place of a file."""

    place: tuple[str, ...]
    """Keys and numbers of list items on the way to it."""
    said: str
    """What is wrong there, and what is allowed."""


class Key(NamedTuple):
    """Description of a key of a section of a file."""

    name: str
    unit: str
    allowed: str
    default: str
    """Empty where it need not be given, and has no value then."""
    required: bool
    about: str


S = TypeVar("S", bound=BaseModel)


def _no_flag(value: Any) -> Any:
    if isinstance(value, bool):  # which Python takes for 0 or 1
        raise PydanticCustomError("float_type", "a number is expected")
    return value


def _or_empty(value: Any) -> Any:
    return {} if value is None else value


def _as_text(value: Any) -> Any:
    return str(value) if isinstance(value, int | float) else value


#: A finite number; a text that reads as one (YAML takes 1e-3 for a text) is one.
Number = Annotated[float, BeforeValidator(_no_flag), Field(allow_inf_nan=False)]
#: A whole number.
Whole = Annotated[int, BeforeValidator(_no_flag)]
#: A text that is not empty.
Text = Annotated[str, Field(min_length=1)]
#: A key of a mapping, or a remark; YAML takes some of them for numbers.
Name = Annotated[str, BeforeValidator(_as_text)]
T = TypeVar("T")
#: A mapping from names, which may be left empty in the file.
Names = Annotated[dict[Name, T], BeforeValidator(_or_empty)]


def refuse(said: str, field: str = "") -> NoReturn:
    """Refuse a value in a validator of a schema.

    Parameters
    ----------
    said : str
        What is wrong with it: ``5 is out of range; allowed: > 7``.
    field : str
        The field below the validated one that is meant, if any.
    """
    raise PydanticCustomError(_OWN, "{said}", {"said": said, "field": field})


#: Kinds of files, each with a field that all of its files have, and none of those of an earlier kind.
_MARKS: Final = {
    "plan": "segments", "bench file": "parameters", "map file": "columns", "model file": "bench"
}  # fmt: skip


def check(
    schema: type[S], content: Any, where: str, *, kind: str = "", separator: str = ": ", every: bool = False
) -> S:
    """Return the content of a file, checked against its schema.

    Parameters
    ----------
    schema : type of BaseModel
        What is allowed, as a class of pydantic (see `Section`).
    content : object
        What was read, made of mappings, lists and scalars.
    where : str
        The file, or the place in a file; messages begin with it.
    kind : str
        Kind of file, such as ``plan``, for the message if the content is not a mapping.
    separator : str
        Text between `where` and the name of the field: ``.`` if `where` is a place in a file.
    every : bool
        Whether to report all errors, not only the first.

    Raises
    ------
    InputError
        If something is missing, unknown or not allowed. The message is one line: file, field, value, what is allowed.
    """
    if kind and not isinstance(content, Mapping):
        needed = [field.alias or name for name, field in schema.model_fields.items() if field.is_required()]
        raise InputError(f"{where}: not a {kind} (a mapping with {', '.join(needed)} is expected)")
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        told = list(itertools.islice(_told(schema, error), None if every else 1))
    others = [name for name, mark in _MARKS.items() if kind in _MARKS and mark in content]
    if others and kind not in others:
        raise InputError(f"{where}: is a {others[0]}; allowed: a {kind}")
    found = [f"{'.'.join(place)}: {said}" if place else said for place, said in told]
    raise InputError(f"{where}{separator if told[0].place else ': '}{joined(found)}")


def joined(found: Sequence[str]) -> str:
    """Return error messages in one line; of very many, the first ones and the number of the others."""
    more = len(found) - _MOST_TOLD
    return "; ".join([*found[:_MOST_TOLD], *([f"and {more} more"] if more > 0 else [])])


def problems(schema: type[BaseModel], content: Any) -> list[Problem]:
    """Return all errors that `check` finds in the content of a file."""
    try:
        schema.model_validate(content)
    except ValidationError as error:
        return list(_told(schema, error))
    return []


def keys(schema: type[BaseModel]) -> list[Key]:
    """Return descriptions of the keys of a section, for a page; a unit is the extra ``unit`` of a field's schema."""
    document = schema.model_json_schema(by_alias=True)
    found = []
    for name, field in schema.model_fields.items():
        shown_as = field.alias or name
        node = document["properties"][shown_as]
        required = field.is_required()
        default = (
            "" if required or field.default is None else str(field.get_default(call_default_factory=True))
        )
        unit = str(node.get("unit", ""))
        kinds = dict.fromkeys(
            _kind(document, n) for n in _resolved(document, node) if n.get("type") != "null"
        )
        found.append(
            Key(shown_as, unit, " or ".join(filter(None, kinds)), default, required, field.description or "")
        )
    return found


def _kind(document: Node, node: Node) -> str:
    """Return the allowed values of a node of the schema in words."""
    if node.get("type") == "array":
        if "prefixItems" in node:
            each = [
                " or ".join(_kind(document, n) for n in _resolved(document, item))
                for item in node["prefixItems"]
            ]
            return f"[{', '.join(each)}]"
        items = " or ".join(_kind(document, n) for n in _resolved(document, node.get("items", {})))
        return f"list of {items}"
    return _values(node) or {"object": "mapping", "string": "text", "integer": "whole number"}.get(
        str(node.get("type")), "number"
    )


def finite(value: Any, where: str) -> float:
    """Return a value as a finite number, as `Number` takes it.

    Raises
    ------
    InputError
        If it is not a finite number; the message begins with `where`.
    """
    try:
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: {shown(value)} is not a number") from None
    if not math.isfinite(number):
        raise InputError(f"{where}: {shown(value)} is not finite")
    return number


def shown(value: Any) -> str:
    """Return a value for a message: in one line, cut if it is long."""
    text = one_line(ValueError(repr(value)))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _told(schema: type[BaseModel], error: ValidationError) -> Iterator[Problem]:
    """Yield the errors, one for each place, the most helpful first."""
    document = schema.model_json_schema(by_alias=True)
    errors = error.errors(include_url=False)
    # another version of the schema explains all else, and an unknown key often the one that is missing
    errors.sort(key=lambda e: (e["loc"] != ("schema",), e["type"] != "extra_forbidden"))
    seen = set()
    for first in errors:
        _, _, branch = _walk(document, first["loc"])
        if branch is None:
            yield _problem(document, first)
        elif (place := first["loc"][:branch]) not in seen:
            # each kind of value that is allowed here complains; the one that got furthest was meant
            seen.add(place)
            rivals = [e for e in errors if e["loc"][:branch] == place]
            yield _problem(document, max(rivals, key=lambda e: len(_walk(document, e["loc"])[0])))


def _problem(document: Node, error: Mapping[str, Any]) -> Problem:
    """Return an error of pydantic with the message of this project."""
    path, nodes, _ = _walk(document, error["loc"])
    kind, context = error["type"], error.get("ctx", {})
    if kind == "extra_forbidden":
        _, above, _ = _walk(document, error["loc"][:-1])
        return Problem(tuple(path), f"no such field; {nearest(path[-1], _names(above))}")
    if kind == _OWN:
        return Problem((*path, *([context["field"]] if context["field"] else [])), str(context["said"]))
    if kind == "value_error":
        return Problem(tuple(path), one_line(context["error"]))
    said = _SAID.get(kind, "{} is not allowed: " + _lower(error["msg"])).format(shown(error["input"]))
    allowed = _allowed(nodes, count=kind.startswith(("too_", "string_too_"))) if kind in _SAID else ""
    return Problem(tuple(path), said + (f"; allowed: {allowed}" if allowed else ""))


Node = Mapping[str, Any]


def _walk(document: Node, place: Sequence[str | int]) -> tuple[list[str], list[Node], int | None]:
    """Follow a place through the JSON schema of a file.

    Returns the names on the way, what is allowed there, and the length of the place before the first name of a kind
    of value (which pydantic puts between the fields where several kinds are allowed), None if there is no such name.
    """
    nodes, path, branch = _resolved(document, document), [], None
    for depth, part in enumerate(place):
        if part == "[key]":  # what pydantic says when the key itself is wrong
            continue
        below = [n for node in nodes for n in _below(document, node, part)]
        titles = {node.get("title") for node in nodes}
        if not below and isinstance(part, str) and depth and (part in titles or not _takes_names(nodes)):
            branch = depth if branch is None else branch
            continue
        path.append(_key(part))
        nodes = below
    return path, nodes, branch


def _takes_names(nodes: Sequence[Node]) -> bool:
    return not nodes or any("properties" in n or "additionalProperties" in n for n in nodes)


def _resolved(document: Node, node: Node) -> list[Node]:
    """Return the kinds of value that a node of the schema allows."""
    if "$ref" in node:
        return _resolved(document, document["$defs"][node["$ref"].rsplit("/", 1)[-1]])
    kinds = [*node.get("anyOf", ()), *node.get("oneOf", ())]
    return [n for kind in kinds for n in _resolved(document, kind)] if kinds else [node]


def _below(document: Node, node: Node, part: str | int) -> Iterator[Node]:
    found: Any = None
    if isinstance(part, int):
        first = node.get("prefixItems", ())
        found = first[part] if part < len(first) else node.get("items")
    elif part in node.get("properties", {}):
        found = node["properties"][part]
    else:
        found = node.get("additionalProperties")
    if isinstance(found, Mapping):
        yield from _resolved(document, found)


def _names(nodes: Sequence[Node]) -> Iterator[str]:
    for node in nodes:
        yield from node.get("properties", ())


#: Bounds of numbers: names in JSON schema, and names behind a validator.
_BOUNDS: Final = {
    ">": ("exclusiveMinimum", "gt"),
    ">=": ("minimum", "ge"),
    "<": ("exclusiveMaximum", "lt"),
    "<=": ("maximum", "le"),
}
_COUNTS: Final = {"minItems": ">=", "maxItems": "<=", "minLength": ">=", "maxLength": "<="}


def _allowed(nodes: Sequence[Node], *, count: bool) -> str:
    """Return the allowed values, or the allowed lengths, in words."""
    words = (_length(node) if count else _values(node) for node in nodes)
    return " or ".join(dict.fromkeys(word for word in words if word))


def _values(node: Node) -> str:
    if "const" in node:
        return str(node["const"])
    if "enum" in node:
        return ", ".join(map(str, node["enum"]))
    if "pattern" in node:
        return f"a text of the form {node['pattern']}"
    bounds = {sign: node[name] for sign, names in _BOUNDS.items() for name in names if name in node}
    if bounds.keys() == {">=", "<="}:
        return f"{bounds['>=']:g} .. {bounds['<=']:g}"
    if bounds:
        return " and ".join(f"{sign} {value:g}" for sign, value in bounds.items())
    return str(node.get("allowed", ""))  # a field may say it in words


def _length(node: Node) -> str:
    parts = [f"{sign} {node[name]}" for name, sign in _COUNTS.items() if name in node]
    return f"length {' and '.join(parts)}" if parts else ""


def _key(part: str | int) -> str:
    text = str(part)
    return text if text.isprintable() and len(text) <= _LONGEST else shown(part)


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]
