"""What a message says that cannot be done."""

from __future__ import annotations


class FieldError(ValueError):
    """A field of a message that is not valid or cannot be served. ``field`` is its path in the message:
    "dynamic_objects[2].track_id"."""

    def __init__(self, field: str, fault: str) -> None:
        super().__init__(f"{field}: {fault}")
        self.field = field
