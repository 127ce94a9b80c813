"""Readers of edits, and a line for each file here.

The order is that in which edits stand in a scenario: those of actors first, and those of one actor as they are applied.
"""

# isort: off
from .actors import Actors as Actors
from .static_items import StaticItems as StaticItems
from .ego import EgoReader as EgoReader
from .sensors import SensorReader as SensorReader
from .maneuvers import Maneuvers as Maneuvers
from .lamps import LampReader as LampReader
