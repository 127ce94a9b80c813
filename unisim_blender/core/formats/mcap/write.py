"""A run as one MCAP file of Foxglove's messages, which Foxglove and Rerun open."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from ...files import partial_file
from ..common.messages import Run, RunFormat

CHUNK_BYTES = 4 << 20
"""A chunk ends with the message that reaches this size: fixed, so that equal runs are equal bytes."""


def write_mcap(run: Run, path: Path) -> None:
    """Write a run as MCAP; one message is in memory at a time, and one chunk. Log times are the captures' times."""
    from mcap.writer import CompressionType, Writer
    from mcap_protobuf.schema import register_schema

    from .foxglove import FoxgloveEncoder

    encode = FoxgloveEncoder().encode
    channels: dict[str, int] = {}
    schemas: dict[str, int] = {}
    counts: Counter[str] = Counter()
    with partial_file(path) as temporary, temporary.open("wb") as file:
        writer: Any = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="", library="unisim_blender")
        writer.add_metadata("unisim", run.about())
        for message in run.messages():
            for topic, content in encode(message):
                name = content.DESCRIPTOR.full_name
                if name not in schemas:
                    schemas[name] = register_schema(writer, type(content))
                if topic not in channels:
                    channels[topic] = writer.register_channel(topic, "protobuf", schemas[name])
                data = content.SerializeToString(deterministic=True)
                writer.add_message(channels[topic], message.time_ns, data, message.time_ns, counts[topic])
                counts[topic] += 1
        writer.finish()


MCAP = RunFormat(
    "mcap",
    "run.mcap",
    ("mcap.writer", "mcap_protobuf.schema", "foxglove_schemas_protobuf", "zstandard"),
    ("png", "npz", "labels"),
    write_mcap,
)
