"""A run as a ROS 2 bag: a folder with one MCAP file and its `metadata.yaml`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ..files import partial_folder
from .finished_run import FinishedRun
from .run_format import RunFormat

VERSION: Final = 9
"""Of a bag's metadata; ROS 2 Jazzy and later write it, and earlier ones read it."""


def write_rosbag(run: FinishedRun, path: Path) -> None:
    """Write a run as a bag; one message is in memory at a time, and one chunk. Stamps are the captures' times."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    from .ros import TYPES, Topics, encode

    topics = Topics()
    with partial_folder(path) as temporary:
        writer = Writer(temporary, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for name, text in run.about().items():
            writer.set_custom_data(name, text)
        with writer:
            connections = {}
            for message in run.messages():
                for topic, content in encode(message, topics):
                    kind = content.__msgtype__
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
                    writer.write(connections[topic], message.time_ns, TYPES.serialize_cdr(content, kind))


ROSBAG = RunFormat(
    "rosbag",
    "a ROS 2 bag, which needs no ROS to be written",
    "rosbag",
    ("rosbags.rosbag2", "rosbags.typesys"),
    ("png", "npz", "labels"),
    write_rosbag,
)
