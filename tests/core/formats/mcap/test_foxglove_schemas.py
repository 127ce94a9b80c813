"""Foxglove itself cannot be run in a test; what it is told of messages is compared with what its own SDK says of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from exported_run import as_rollout, render_tiny

from unisim_blender.core.export.formats import write_run

pytest.importorskip("mcap_protobuf", reason="the extra mcap is not installed: pip install '.[mcap]'")
sdk = pytest.importorskip("foxglove.messages", reason="Foxglove's SDK is not installed: make test-schemas")

Fields = dict[str, set[tuple[Any, ...]]]


def fields_of(data: bytes) -> Fields:
    """Return the fields of all messages of a set of protobuf's descriptors, and the values of all enumerations, by full name."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    found: Fields = {}

    def add(message: Any, place: str) -> None:
        name = f"{place}.{message.name}"
        found[name] = {(one.number, one.name, one.type, one.label, one.type_name) for one in message.field}
        for inner in message.nested_type:
            add(inner, name)
        for enum in message.enum_type:
            found[f"{name}.{enum.name}"] = {(value.number, value.name) for value in enum.value}

    for file in FileDescriptorSet.FromString(data).file:
        for message in file.message_type:
            add(message, file.package)
        for enum in file.enum_type:
            found[f"{file.package}.{enum.name}"] = {(value.number, value.name) for value in enum.value}
    return found


def test_the_files_schemas_are_those_of_foxgloves_sdk(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    with write_run("mcap", as_rollout(render_tiny(tmp_path / "out"))).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    encodings = {channel.message_encoding for channel in summary.channels.values()}
    names = {schema.name for schema in summary.schemas.values()}
    assert encodings == {"protobuf"} and names == {
        "foxglove.CameraCalibration", "foxglove.CompressedImage", "foxglove.FrameTransforms", "foxglove.Odometry",
        "foxglove.PointCloud", "foxglove.PosesInFrame", "foxglove.SceneUpdate",
    }  # fmt: skip
    for schema in summary.schemas.values():
        theirs = getattr(sdk, schema.name.removeprefix("foxglove.")).get_schema()
        assert (schema.name, schema.encoding) == (theirs.name, theirs.encoding)
        mine, published = fields_of(schema.data), fields_of(theirs.data)
        assert len(mine) >= 2 and mine[schema.name]
        for name, fields in mine.items():
            assert fields <= published[name], (schema.name, name, fields - published[name])
