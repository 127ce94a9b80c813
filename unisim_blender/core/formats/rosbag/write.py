"""A run as a ROS 2 bag: a folder with one MCAP file and its `metadata.yaml`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ...files import partial_folder
from ..common.messages import MOUNTS, Run, RunFormat

VERSION: Final = 9
"""Of a bag's metadata; ROS 2 Jazzy and later write it, and earlier ones read it."""


def write_rosbag(run: Run, path: Path) -> None:
    """Write a run as a bag; one message is in memory at a time, and one chunk. Stamps are the captures' times."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    from .ros import TYPES, RosEncoder

    encoder = RosEncoder()
    forever = QosTime(0, 0)
    # one message for all who listen later, too, as ROS publishes static transforms
    latched = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
    with partial_folder(path) as temporary:
        writer = Writer(temporary, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for name, text in run.about().items():
            writer.set_custom_data(name, text)
        with writer:
            connections = {}
            for message in run.messages():
                for topic, content in encoder.encode(message):
                    kind = content.__msgtype__
                    if topic not in connections:
                        profiles = [latched] if topic == MOUNTS else []
                        connections[topic] = writer.add_connection(
                            topic, kind, typestore=TYPES, offered_qos_profiles=profiles
                        )
                    writer.write(connections[topic], message.time_ns, TYPES.serialize_cdr(content, kind))


ROSBAG = RunFormat("rosbag", "rosbag", ("rosbags.rosbag2", "rosbags.typesys"), ("png", "npz", "labels"), write_rosbag)
