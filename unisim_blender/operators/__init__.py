"""Operators, in the order in which they are registered, and where people find them beside the sidebar: menus, shortcuts,
the pie, the manual."""

from ..features.actor_list import operators as actor_list
from ..features.actors import appearances, assets, meshes, static_items
from ..features.actors import operators as actors
from ..features.batch import operators as batch
from ..features.check import operators as check
from ..features.drive import export_operators as export_scenario
from ..features.drive import import_operators as import_drive
from ..features.edits import operators as edits
from ..features.ego import body as ego_body
from ..features.ego import operators as ego
from ..features.motion import drag, paths, retime, shift
from ..features.motion import settings as motion_settings
from ..features.output import operators as render_sequence
from ..features.output import results
from ..features.points import operators as points
from ..features.sensors import operators as sensors
from ..features.sensors import rig_presets
from ..features.simulation import actor_models
from ..features.simulation import operators as simulate
from ..features.training import operators as train
from ..features.variants import operators as variants
from ..process import background, test_renderer

MODULES = (
    motion_settings,
    import_drive,
    export_scenario,
    actor_list,
    actors,
    edits,
    appearances,
    meshes,
    paths,
    retime,
    shift,
    static_items,
    ego,
    ego_body,
    sensors,
    drag,
    rig_presets,
    points,
    background,
    render_sequence,
    results,
    simulate,
    batch,
    actor_models,
    variants,
    train,
    test_renderer,
    check,
    assets,
)
