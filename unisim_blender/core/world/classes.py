"""Kinds of motion of actors by class, a table for each dataset's names. Labels keep a dataset's own name.

``rigid``: moves as one piece. ``deforming``: changes its shape as it moves, as a person does, or a rider with a bicycle
in one box. ``still``: stands where it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

Motion = Literal["rigid", "deforming", "still"]

PANDASET: dict[str, Motion] = {
    **dict.fromkeys(
        ("Car", "Pickup Truck", "Medium-sized Truck", "Semi-truck", "Towed Object", "Motorcycle", "Bus", "Train",
         "Trolley", "Tram / Subway", "Other Vehicle - Construction Vehicle", "Other Vehicle - Uncommon",
         "Other Vehicle - Pedicab", "Emergency Vehicle", "Personal Mobility Device", "Motorized Scooter",
         "Rolling Containers"), "rigid",
    ),
    **dict.fromkeys(("Pedestrian", "Pedestrian with Object", "Bicycle", "Animals - Bird", "Animals - Other"), "deforming"),
    **dict.fromkeys(
        ("Pylons", "Road Barriers", "Signs", "Cones", "Construction Signs", "Temporary Construction Barriers"), "still"
    ),
}  # fmt: skip
ARGOVERSE2: dict[str, Motion] = {
    **dict.fromkeys(
        ("REGULAR_VEHICLE", "LARGE_VEHICLE", "BOX_TRUCK", "TRUCK", "TRUCK_CAB", "VEHICULAR_TRAILER", "BUS", "SCHOOL_BUS",
         "ARTICULATED_BUS", "RAILED_VEHICLE", "MOTORCYCLE", "BICYCLE", "WHEELED_DEVICE"), "rigid",
    ),
    **dict.fromkeys(
        ("MOTORCYCLIST", "BICYCLIST", "WHEELED_RIDER", "PEDESTRIAN", "OFFICIAL_SIGNALER", "STROLLER", "WHEELCHAIR", "DOG",
         "ANIMAL"), "deforming",
    ),
    **dict.fromkeys(
        ("BOLLARD", "CONSTRUCTION_CONE", "CONSTRUCTION_BARREL", "SIGN", "STOP_SIGN", "MOBILE_PEDESTRIAN_CROSSING_SIGN",
         "MESSAGE_BOARD_TRAILER", "TRAFFIC_LIGHT_TRAILER"), "still",
    ),
}  # fmt: skip
NUSCENES: dict[str, Motion] = {
    "vehicle": "rigid",
    "human": "deforming",
    "animal": "deforming",
    "movable_object": "still",
    "static_object": "still",
}
"""Kinds of motion by the first part of a name: "vehicle" for vehicle.bus.rigid."""
KITTI: dict[str, Motion] = {
    **dict.fromkeys(("Car", "Van", "Truck", "Tram", "Misc"), "rigid"),
    **dict.fromkeys(("Cyclist", "Pedestrian", "Person_sitting", "Person"), "deforming"),
}
"""Tracking labels have Person for Person_sitting."""
WAYMO: dict[str, Motion] = {
    "TYPE_VEHICLE": "rigid",
    "TYPE_PEDESTRIAN": "deforming",
    "TYPE_CYCLIST": "deforming",
    "TYPE_SIGN": "still",
}
ZOD: dict[str, Motion] = {
    **dict.fromkeys(("Vehicle", "LargeVehicle", "Trailer", "Motorcyclist", "Bicyclist"), "rigid"),
    "Pedestrian": "deforming",
}
NVIDIA: dict[str, Motion] = {
    **dict.fromkeys(
        ("automobile", "heavy_truck", "bus", "train_or_tram_car", "trolley_bus", "other_vehicle", "trailer"), "rigid"
    ),
    **dict.fromkeys(("person", "rider", "stroller", "animal"), "deforming"),
    "protruding_object": "still",
}
"""Kinds of motion of NVIDIA's Physical AI dataset, which is in NCore's format."""
TABLES: tuple[Mapping[str, Motion], ...] = (PANDASET, ARGOVERSE2, NUSCENES, KITTI, WAYMO, ZOD, NVIDIA)


def motion_of(label: str, own: Mapping[str, Motion] | None = None) -> Motion | None:
    """Return the kind of motion of a class, by ``own`` names first; None where no table has the name or its part before
    the first dot."""
    for table in (own or {}, *TABLES):
        name = label
        while name:
            if name in table:
                return table[name]
            name = name.rpartition(".")[0]
    return None
