"""Readers of edits, and a line for each here.

The order is that in which edits stand in a scenario: those of actors first, and those of one actor as they are applied.
"""

# isort: off
from .actors import Actors as Actors
from .actor_edits import RemoveReader as RemoveReader
from .actor_edits import SwapReader as SwapReader
from .actor_edits import MoveReader as MoveReader
from .actor_edits import ScaleReader as ScaleReader
from .actor_edits import DuplicateReader as DuplicateReader
from .actor_edits import InsertReader as InsertReader
from .actor_edits import InsertMeshReader as InsertMeshReader
from .static_items import StaticItems as StaticItems
from .ego import EgoReader as EgoReader
from .ego import EgoBodies as EgoBodies
from .sensors import SensorReader as SensorReader
