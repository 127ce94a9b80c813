"""Fragments of JSON Schema that the parts of a scenario share. Each part has its own schema beside its type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Schema = Mapping[str, Any]
"""A JSON Schema, draft 2020-12, as Python values."""

NUMBER: Schema = {"type": "number"}
POSITIVE: Schema = {"type": "number", "exclusiveMinimum": 0}
NOT_NEGATIVE: Schema = {"type": "number", "minimum": 0}
FRAME: Schema = {"type": "integer", "minimum": 0}
PIXELS: Schema = {"type": "integer", "minimum": 1, "maximum": 32768}
TEXT: Schema = {"type": "string", "minLength": 1, "maxLength": 200}
"""An id, a class or another short text."""
PATH: Schema = {"type": "string", "minLength": 1, "maxLength": 4096}
"""A file or a folder, relative to the scenario's file."""


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
