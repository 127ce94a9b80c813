"""Panels, in the order in which the sidebar has them."""

from ..features import check, ego, first_steps, sidebar, training
from ..features.actor_list import panel as actor_list
from ..features.actors import panel as actors
from ..features.batch import panel as batch
from ..features.drive import panel as drive
from ..features.edits import panel as edits
from ..features.motion import panel as motion
from ..features.output import panel as output
from ..features.sensors import panel as sensors
from ..features.simulation import panel as simulation
from ..features.variants import panel as variants
from . import statusbar

MODULES = (
    sidebar,
    first_steps,
    drive,
    actor_list,
    actors,
    motion,
    edits,
    variants,
    ego,
    sensors,
    check,
    output,
    training,
    simulation,
    batch,
    statusbar,
)
