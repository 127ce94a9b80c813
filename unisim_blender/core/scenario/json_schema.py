"""JSON Schema of dataclasses, from their fields' annotated types, and the fragments that these share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

Schema = Mapping[str, Any]
"""A JSON Schema, draft 2020-12, as Python values."""

NUMBER: Schema = {"type": "number"}
POSITIVE: Schema = {"type": "number", "exclusiveMinimum": 0}
NOT_NEGATIVE: Schema = {"type": "number", "minimum": 0}
FRAME: Schema = {"type": "integer", "minimum": 0}
TEXT: Schema = {"type": "string", "minLength": 1, "maxLength": 200}
"""An id, a class or another short text."""
PATH: Schema = {"type": "string", "minLength": 1, "maxLength": 4096}
"""A file or a folder, relative to the scenario's file."""


@dataclass(frozen=True, eq=False)
class SchemaOf:
    """The JSON Schema of an `Annotated` type."""

    schema: Schema


Positive = Annotated[float, SchemaOf(POSITIVE)]
NotNegative = Annotated[float, SchemaOf(NOT_NEGATIVE)]
PixelCount = Annotated[int, SchemaOf({"type": "integer", "minimum": 1, "maximum": 32768})]
FilePath = Annotated[str, SchemaOf(PATH)]


def numbers(count: int, item: Schema = NUMBER) -> Schema:
    """Return the schema of an array of ``count`` numbers."""
    return {"type": "array", "items": item, "minItems": count, "maxItems": count}


VECTOR = numbers(3)


def ref(name: str) -> Schema:
    """Return a reference to the definition in ``$defs`` under a name."""
    return {"$ref": f"#/$defs/{name}"}


def members_of(properties: Mapping[str, Schema], required: Sequence[str] = (), about: str = "") -> Schema:
    """Return the schema of an object with these members and no others."""
    return {
        "type": "object",
        "properties": dict(properties),
        **({"required": list(required)} if required else {}),
        "additionalProperties": False,
        **({"description": about} if about else {}),
    }


def required_fields(kind: Any) -> list[str]:
    """Return the names of a dataclass's fields that have no default."""
    return [field.name for field in fields(kind) if field.default is MISSING]


def object_of(kind: Any, about: str = "") -> Schema:
    """Return the schema of a dataclass: its fields, of which those without a default are required."""
    return members_of(schemas_of(kind), required_fields(kind), about)


def schemas_of(kind: Any) -> dict[str, Schema]:
    """Return the schema of each field of a dataclass, by its name."""
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: schema_of(hints[field.name]) for field in fields(kind)}


def schema_of(hint: Any) -> Schema:
    """Return the schema of an annotated type; None, which is a member that is missing, aside. A dataclass is a definition
    under its name: ``FrameRange`` is ``frame_range``, ``CameraSpec`` is ``camera``."""
    origin, choices = get_origin(hint), get_args(hint)
    if origin is Annotated:
        schema: Schema = hint.__metadata__[-1].schema
        return schema
    if origin in (Union, UnionType):
        (present,) = (choice for choice in choices if choice is not NoneType)
        return schema_of(present)
    if origin is tuple and choices[-1] is Ellipsis:
        return {"type": "array", "items": schema_of(choices[0]), "minItems": 1}
    if origin is tuple:
        return numbers(len(choices), schema_of(choices[0]))
    if is_dataclass(hint):
        name = hint.__name__.removesuffix("Spec")  # type: ignore[union-attr]
        return ref("".join(f"_{c.lower()}" if c.isupper() else c for c in name).removeprefix("_"))
    plain: dict[Any, Schema] = {float: NUMBER, int: FRAME, str: TEXT, bool: {"type": "boolean"}}
    return plain[hint]


def state_members(kind: Any, what: str) -> None:
    """Give a class of documents the schemas of its fields as its ``members``, where it does not state them itself. Raises
    `TypeError` where those that it states are not its fields'."""
    if "members" not in vars(kind):
        kind.members = schemas_of(kind)
    stated, names = sorted(kind.members), sorted(field.name for field in fields(kind))
    if stated != names:
        raise TypeError(f'{what} "{kind.type}": members {stated} are not its fields {names}')


def about_of(kind: type) -> str:
    """Return the first paragraph of a class's docstring."""
    return " ".join((kind.__doc__ or "").partition("\n\n")[0].split())


def choice_of(schemas: Mapping[str, Schema]) -> Schema:
    """Return the schema of an object whose ``type`` says which of these it has."""
    return {
        "type": "object",
        "required": ["type"],
        "properties": {"type": {"enum": list(schemas)}},
        "allOf": [
            {"if": {"properties": {"type": {"const": name}}, "required": ["type"]}, "then": schema}
            for name, schema in schemas.items()
        ],
    }
