"""A scenario's edits, one file each: its type, its schema, its check, its effect, and who of Blender's side reads it.

Each line registers one; their order is that of the names in the schema and in its messages.
"""

# isort: off
from .remove import Remove as Remove
from .duplicate import Duplicate as Duplicate
from .insert import Insert as Insert
from .insert_mesh import InsertMesh as InsertMesh
from .ego_body import EgoBody as EgoBody
from .move import Move as Move
from .retime import Retime as Retime
from .swap import Swap as Swap
from .scale import Scale as Scale
from .copy_static import CopyStatic as CopyStatic
from .remove_static import RemoveStatic as RemoveStatic
from .ego import Ego as Ego
from .lane_change import LaneChange as LaneChange
from .brake import Brake as Brake
from .cut_in import CutInManeuver as CutInManeuver
from .cross import Cross as Cross
from .follow import Follow as Follow
from .row import Row as Row
from .lamp import Lamp as Lamp
