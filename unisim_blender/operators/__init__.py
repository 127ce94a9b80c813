"""Operators, in the order in which they are registered, and where people find them beside the sidebar: menus, shortcuts,
the pie, the manual. Features of one file are registered where their panels are."""

from ..features import problems, settings
from ..features.actor_list import operators as actor_list
from ..features.actors import appearances, assets
from ..features.actors import operators as actors
from ..features.batch import operators as batch
from ..features.drive import export_operators, import_operators
from ..features.edits import operators as edits
from ..features.motion import drag, maneuvers, rows
from ..features.motion import operators as motion
from ..features.motion import properties as motion_properties
from ..features.output import operators as output
from ..features.points import birds_eye
from ..features.points import operators as points
from ..features.sensors import operators as sensors
from ..features.sensors import rig_presets
from ..features.simulation import operators as simulation
from ..features.variants import operators as variants
from ..process import background, interpreters, packages, preparation

MODULES = (
    motion_properties,
    import_operators,
    export_operators,
    actor_list,
    actors,
    edits,
    appearances,
    motion,
    maneuvers,
    sensors,
    drag,
    rows,
    rig_presets,
    points,
    birds_eye,
    background,
    preparation,
    output,
    simulation,
    batch,
    variants,
    interpreters,
    packages,
    problems,
    settings,
    assets,
)
