"""Class names of one dataset in another's words, so that what is trained on a dataset finds the classes that it knows.

A name that the dataset has itself is kept; one that no table has is kept, too, or is the dataset's word for anything
else.
"""

from __future__ import annotations

from dataclasses import replace

from ...world import classes
from ...world.drive import Drive

_KINDS: dict[str, tuple[str, ...]] = {
    "car": ("Car", "REGULAR_VEHICLE", "vehicle.car", "TYPE_VEHICLE", "Vehicle", "automobile", "car"),
    "pickup": ("Pickup Truck",),
    "van": ("Van",),
    "truck": ("Medium-sized Truck", "Truck", "TRUCK", "BOX_TRUCK", "LARGE_VEHICLE", "vehicle.truck", "LargeVehicle",
              "heavy_truck", "truck"),
    "semi": ("Semi-truck", "TRUCK_CAB"),
    "bus": ("Bus", "BUS", "SCHOOL_BUS", "vehicle.bus.rigid", "bus", "trolley_bus", "Trolley"),
    "long bus": ("ARTICULATED_BUS", "vehicle.bus.bendy"),
    "train": ("Train", "Tram / Subway", "Tram", "RAILED_VEHICLE", "train_or_tram_car"),
    "trailer": ("Towed Object", "VEHICULAR_TRAILER", "vehicle.trailer", "Trailer", "trailer"),
    "digger": ("Other Vehicle - Construction Vehicle", "vehicle.construction", "construction_vehicle"),
    "emergency": ("Emergency Vehicle", "vehicle.emergency.police", "vehicle.emergency.ambulance"),
    "motorcycle": ("Motorcycle", "MOTORCYCLE", "MOTORCYCLIST", "vehicle.motorcycle", "Motorcyclist", "motorcycle"),
    "bicycle": ("Bicycle", "BICYCLE", "vehicle.bicycle", "bicycle"),
    "cyclist": ("Cyclist", "BICYCLIST", "TYPE_CYCLIST", "Bicyclist", "rider"),
    "scooter": ("Personal Mobility Device", "Motorized Scooter", "WHEELED_DEVICE", "WHEELED_RIDER",
                "human.pedestrian.personal_mobility"),
    "pedestrian": ("Pedestrian", "PEDESTRIAN", "OFFICIAL_SIGNALER", "TYPE_PEDESTRIAN", "human.pedestrian.adult",
                   "human.pedestrian.child", "human.pedestrian.construction_worker",
                   "human.pedestrian.police_officer", "person", "pedestrian"),
    "carrying": ("Pedestrian with Object",),
    "sitting": ("Person_sitting",),
    "stroller": ("STROLLER", "human.pedestrian.stroller", "stroller"),
    "wheelchair": ("WHEELCHAIR", "human.pedestrian.wheelchair"),
    "animal": ("Animals - Other", "Animals - Bird", "DOG", "ANIMAL", "animal"),
    "cone": ("Cones", "CONSTRUCTION_CONE", "movable_object.trafficcone", "traffic_cone"),
    "post": ("Pylons", "BOLLARD", "CONSTRUCTION_BARREL"),
    "barrier": ("Road Barriers", "Temporary Construction Barriers", "movable_object.barrier", "barrier"),
    "sign": ("Signs", "Construction Signs", "SIGN", "STOP_SIGN", "TYPE_SIGN"),
}  # fmt: skip
"""Class names of all datasets, by the kind of object that they stand for."""
_PANDASET = {
    "car": "Car", "pickup": "Pickup Truck", "van": "Car", "truck": "Medium-sized Truck", "semi": "Semi-truck", "bus": "Bus",
    "long bus": "Bus", "train": "Train", "trailer": "Towed Object", "digger": "Other Vehicle - Construction Vehicle",
    "emergency": "Emergency Vehicle", "motorcycle": "Motorcycle", "bicycle": "Bicycle", "cyclist": "Bicycle",
    "scooter": "Personal Mobility Device", "pedestrian": "Pedestrian", "carrying": "Pedestrian with Object",
    "sitting": "Pedestrian", "stroller": "Pedestrian with Object", "wheelchair": "Personal Mobility Device",
    "animal": "Animals - Other", "cone": "Cones", "post": "Pylons", "barrier": "Road Barriers", "sign": "Signs",
}  # fmt: skip
_KITTI = {
    "car": "Car", "pickup": "Van", "van": "Van", "truck": "Truck", "semi": "Truck", "bus": "Truck", "long bus": "Truck",
    "train": "Tram", "digger": "Truck", "emergency": "Van", "bicycle": "Cyclist", "cyclist": "Cyclist",
    "pedestrian": "Pedestrian", "carrying": "Pedestrian", "sitting": "Person_sitting", "stroller": "Pedestrian",
}  # fmt: skip
_NUSCENES = {
    "car": "vehicle.car", "pickup": "vehicle.truck", "van": "vehicle.car", "truck": "vehicle.truck",
    "semi": "vehicle.truck", "bus": "vehicle.bus.rigid", "long bus": "vehicle.bus.bendy", "trailer": "vehicle.trailer",
    "digger": "vehicle.construction", "emergency": "vehicle.emergency.police", "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle", "cyclist": "vehicle.bicycle", "scooter": "human.pedestrian.personal_mobility",
    "pedestrian": "human.pedestrian.adult", "carrying": "human.pedestrian.adult", "sitting": "human.pedestrian.adult",
    "stroller": "human.pedestrian.stroller", "wheelchair": "human.pedestrian.wheelchair", "animal": "animal",
    "cone": "movable_object.trafficcone", "post": "movable_object.barrier", "barrier": "movable_object.barrier",
}  # fmt: skip
_ARGOVERSE2 = {
    "car": "REGULAR_VEHICLE", "pickup": "REGULAR_VEHICLE", "van": "REGULAR_VEHICLE", "truck": "LARGE_VEHICLE",
    "semi": "TRUCK_CAB", "bus": "BUS", "long bus": "ARTICULATED_BUS", "train": "RAILED_VEHICLE",
    "trailer": "VEHICULAR_TRAILER", "digger": "LARGE_VEHICLE", "emergency": "REGULAR_VEHICLE", "motorcycle": "MOTORCYCLE",
    "bicycle": "BICYCLE", "cyclist": "BICYCLIST", "scooter": "WHEELED_DEVICE", "pedestrian": "PEDESTRIAN",
    "carrying": "PEDESTRIAN", "sitting": "PEDESTRIAN", "stroller": "STROLLER", "wheelchair": "WHEELCHAIR",
    "animal": "ANIMAL", "cone": "CONSTRUCTION_CONE", "post": "BOLLARD", "sign": "SIGN",
}  # fmt: skip
_OWN = {"pandaset": set(classes.PANDASET), "kitti": {*classes.KITTI}, "nuscenes": set(_NUSCENES.values()),
        "argoverse2": {*classes.ARGOVERSE2}}  # fmt: skip
_WORDS = {"pandaset": _PANDASET, "kitti": _KITTI, "nuscenes": _NUSCENES, "argoverse2": _ARGOVERSE2}
_ELSE = {"kitti": "Misc"}
"""Class by which a dataset calls anything that it has no name for."""
_KIND_OF = {name: kind for kind, names in _KINDS.items() for name in names}


def class_name(label: str, dataset: str) -> str:
    """Return a class's name in a dataset's words: "pandaset", "kitti", "nuscenes" or "argoverse2"."""
    if label in _OWN[dataset]:
        return label
    return _WORDS[dataset].get(_KIND_OF.get(label, ""), _ELSE.get(dataset, label))


def renamed(drive: Drive, dataset: str) -> tuple[Drive, dict[str, str]]:
    """Return a drive with its actors' classes in a dataset's words, and the new names of those that were renamed."""
    names = {label: class_name(label, dataset) for label in sorted({actor.label for actor in drive.actors.values()})}
    actors = {uid: replace(actor, label=names[actor.label]) for uid, actor in drive.actors.items()}
    return replace(drive, actors=actors), {label: name for label, name in names.items() if label != name}


def renamed_sentence(names: dict[str, str]) -> str:
    """Return a sentence on the renamed classes; "" where there is none."""
    if not names:
        return ""
    return "classes are renamed: " + ", ".join(f"{label} to {name}" for label, name in names.items())
