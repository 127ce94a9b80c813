"""Actors of a simulation: models of how they move, and what these know of the recorded drive."""

from .model import MODELS as MODELS
from .model import ActorModel as ActorModel
from .model import ActorMotion as ActorMotion
from .model import Model as Model
from .model import model_from_dict as model_from_dict
from .model import models_schema as models_schema
from .models import Attack as Attack
from .models import Auto as Auto
from .models import CutIn as CutIn
from .models import Idm as Idm
from .models import Lane as Lane
from .models import Replay as Replay
from .models import Scripted as Scripted
from .recording import Recording as Recording
