"""Properties of a scene's batches: folder, executor, and parameters."""

import os
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ...editing.simulation.sweeps import Parameter, parsed_values
from ..drive.properties import RELATIVE
from ..sidebar import switch_of

KINDS = (
    ("RANGE", "Range", "Numbers from the first to the last, evenly spaced"),
    ("VALUES", "Values", "Each of a list of values"),
)
EXECUTORS = (
    ("processes", "Processes", "Processes of this machine, of one thread each"),
    ("ray", "Ray", "Workers of Ray: on this machine, or on the cluster whose address is given"),
)


class UniSimParameter(bpy.types.PropertyGroup):
    """A parameter of a batch: ``at`` is the JSON pointer of the scenario's field that it fills, ``about`` says which
    that is."""

    at: StringProperty(name="Field", description="JSON pointer of the field of the scenario that the values go into")
    about: StringProperty(options={"HIDDEN"})
    kind: EnumProperty(name="Kind", description="Values as a range of numbers or as a list", items=KINDS)
    start: FloatProperty(name="First", description="First value", precision=3)
    stop: FloatProperty(name="Last", description="Last value", precision=3)
    count: IntProperty(name="Count", description="Number of values", min=1, max=1000, default=3)
    values: StringProperty(name="Values", description="Numbers or ids, separated by commas: 0, 2.5, car-01")


class UniSimBatch(bpy.types.PropertyGroup):
    """Settings of a scene's batches."""

    out: StringProperty(
        name="Folder",
        description="Folder of the batch, or the URL of an object store: s3://bucket/batch",
        subtype="DIR_PATH",
        default="//batch",
        options=RELATIVE,
    )
    executor: EnumProperty(name="Run on", description="Where the units of the batch are run", items=EXECUTORS)
    address: StringProperty(name="Address", description="Ray cluster: ray://HOST:PORT; this machine if empty")
    jobs: IntProperty(
        name="Workers", description="Number of processes, or of workers of Ray", min=0, soft_min=1, max=1000, default=0
    )
    has_jobs: switch_of(
        "jobs", lambda self: os.cpu_count() or 1, "Set Workers", "Run this number of workers; while off, one a core"
    )
    driven: BoolProperty(
        name="Drive",
        description="Let the driver of the panel Simulate drive through each variant, in place of rendering it",
    )
    parameters: CollectionProperty(type=UniSimParameter)


def parameters_of(scene: bpy.types.Scene) -> list[Parameter]:
    """Return the parameters of a scene's batches. Numbers are those that the fields show: Blender keeps 32 bits."""
    return [_parameter(item) for item in scene.unisim_batch.parameters]


def _parameter(item: Any) -> Parameter:
    if item.kind == "VALUES":
        return Parameter(item.name, item.at, parsed_values(item.values))
    return Parameter(item.name, item.at, (), float(f"{item.start:.6g}"), float(f"{item.stop:.6g}"), item.count)


PROPERTIES = ((bpy.types.Scene, "unisim_batch", PointerProperty(type=UniSimBatch)),)
