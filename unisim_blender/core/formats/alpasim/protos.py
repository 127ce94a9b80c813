"""The compiled messages of AlpaSim's services, under the names that the rest of the package uses. Everything else imports them
from here."""

from __future__ import annotations

from typing import Any

from carla_driver_interface import protocol
from carla_driver_interface.contract import (
    CONTRACT_REVISION,
    ContractError,
    cameras_to_revision,
    contract_metadata,
    negotiate,
)
from carla_driver_interface.protocol import ALPASIM_API_VERSION as API_VERSION
from carla_driver_interface.protocol import CarlaRendererData as RendererData
from carla_driver_interface.protocol import EgodriverServiceStub as EgodriverStub
from carla_driver_interface.protocol import LidarSweep
from google.protobuf.message import DecodeError


class FieldError(ValueError):
    """A field of a message that is not valid or cannot be served. ``field`` is its path in the message:
    "dynamic_objects[2].track_id"."""

    def __init__(self, field: str, fault: str) -> None:
        super().__init__(f"{field}: {fault}")
        self.field = field


# the modules themselves, which the package's protocol has, too, but not under its public names
common: Any = protocol.common_pb2  # type: ignore[attr-defined]
egodriver: Any = protocol.egodriver_pb2  # type: ignore[attr-defined]
sensorsim: Any = protocol.sensorsim_pb2  # type: ignore[attr-defined]

__all__ = [
    "API_VERSION",
    "CONTRACT_REVISION",
    "ContractError",
    "DecodeError",
    "EgodriverStub",
    "LidarSweep",
    "RendererData",
    "cameras_to_revision",
    "common",
    "contract_metadata",
    "egodriver",
    "negotiate",
    "sensorsim",
]
