"""The compiled messages of AlpaSim's services, under the names that the rest of the package uses. Everything else imports them
from here."""

from __future__ import annotations

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
from carla_driver_interface.protocol import LidarSweep, common_pb2, egodriver_pb2, sensorsim_pb2
from google.protobuf.message import DecodeError

common, egodriver, sensorsim = common_pb2, egodriver_pb2, sensorsim_pb2

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
