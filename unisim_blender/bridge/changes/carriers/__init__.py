"""Parts of an object that carry edits: a file each, and a line here. The order is that in which they are
applied to an actor."""

# isort: off
from .scale import ScaleCarrier as ScaleCarrier
from .appearance import AppearanceCarrier as AppearanceCarrier
from .place import PlaceCarrier as PlaceCarrier
from .own_object import ObjectCarrier as ObjectCarrier
