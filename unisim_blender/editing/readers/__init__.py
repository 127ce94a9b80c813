"""Readers of edits: a file for each edit, or for edits that are read as one, and a line for each here.

The order is that in which edits stand in a scenario: those of actors first, and those of one actor as they are applied.
"""

# isort: off
from .actors import Actors as Actors
from .remove import RemoveReader as RemoveReader
from .swap import SwapReader as SwapReader
from .move import MoveReader as MoveReader
from .scale import ScaleReader as ScaleReader
from .duplicate import DuplicateReader as DuplicateReader
from .insert import InsertReader as InsertReader
from .insert_mesh import InsertMeshReader as InsertMeshReader
from .static_items import StaticItems as StaticItems
from .ego import EgoReader as EgoReader
from .ego_bodies import EgoBodies as EgoBodies
from .sensors import SensorReader as SensorReader
