"""The models of actors, one file each: its parameters, their schema, and how its actor moves.

Each line registers one; their order is that of the names in the schema and in its messages.
"""

# isort: off
from .replay import Replay as Replay
from .idm import Idm as Idm
from .auto import Auto as Auto
from .lane import Lane as Lane
from .cut_in import CutIn as CutIn
from .attack import Attack as Attack
from .scripted import Scripted as Scripted
