"""The interface of an actor's model, the check of its parameters, and the models that are registered; see `models`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Annotated, Any, ClassVar, Protocol, TypeVar, get_args, get_type_hints

from ...errors import ScenarioError
from ...registry import Registry
from ...scenario.checks import steps_in_words
from ...scenario.json_schema import Schema, SchemaOf, about_of, choice_of, members_of, required_fields, state_members
from ...scenario.schema import first_fault
from ...world.drive import Actor
from ..states import ActorState, Traffic
from .lead import Lead, Search, find_leads
from .recording import Recording

Speed = Annotated[float, SchemaOf({"type": "number", "minimum": 0, "maximum": 100})]
Acceleration = Annotated[float, SchemaOf({"type": "number", "exclusiveMinimum": 0, "maximum": 50})]
Duration = Annotated[float, SchemaOf({"type": "number", "exclusiveMinimum": 0, "maximum": 600})]
Length = Annotated[float, SchemaOf({"type": "number", "minimum": 0, "maximum": 1000})]
Count = Annotated[int, SchemaOf({"type": "integer", "minimum": 1, "maximum": 1000})]


def check_parameters(value: Any, schema: Schema, place: str) -> None:
    """Raise `ScenarioError` for the first fault of a JSON value by a schema: the place below ``place``, and a sentence."""
    fault = first_fault(value, schema)
    if fault is not None:
        raise ScenarioError(f"{place}{steps_in_words(fault[0])}: {fault[1]}")


@dataclass(frozen=True)
class ActorMotion:
    """An actor's state, and what its model keeps for the next step: a frozen dataclass of the model's own."""

    state: ActorState
    memory: object = None


@dataclass(frozen=True)
class Pending:
    """A motion that depends on what is in the actor's way: ``then`` returns it for the lead that ``search`` finds."""

    search: Search
    then: Callable[[Lead | None], ActorMotion]


Answer = ActorMotion | Pending


class ActorModel(Protocol):
    """How an actor moves. Both functions are pure: the same arguments give the same bits."""

    def start(self, actor: Actor, world: Recording, time_us: int) -> ActorMotion:
        """Return the actor's state at the start of a simulation."""

    def answer(self, actor: Actor, motion: ActorMotion, traffic: Traffic, time_us: int, step_us: int) -> Answer:
        """Return the actor's state at ``time_us + step_us``, from its ``motion`` and the ``traffic`` at ``time_us``; or what it
        depends on: the leads of all actors are found at once (`step_all`)."""


@dataclass(frozen=True)
class Model(ABC):
    """A registered model: its parameters are fields, which are the members of its document.

    Raises `ScenarioError` for a value that its schema does not allow, naming the model and the member.
    """

    type: ClassVar[str]
    """Its name in a document."""
    members: ClassVar[Mapping[str, Schema]]
    """The JSON Schema of each field, which follows from its type (`json_schema.schema_of`) unless it is stated; fields
    without a default are required."""

    def __post_init__(self) -> None:
        check_parameters(parameters_to_json(self), {"properties": self.members}, self.type)
        self.check()

    def check(self) -> None:  # noqa: B027 most models have nothing to say
        """Raise `ScenarioError` for values that contradict each other; see `fail`."""

    def fail(self, member: str, problem: str) -> None:
        """Raise `ScenarioError` for a member."""
        raise ScenarioError(f"{self.type}.{member}: {problem}")

    @abstractmethod
    def start(self, actor: Actor, world: Recording, time_us: int) -> ActorMotion:
        """See `ActorModel.start`."""

    @abstractmethod
    def answer(self, actor: Actor, motion: ActorMotion, traffic: Traffic, time_us: int, step_us: int) -> Answer:
        """See `ActorModel.answer`."""

    def to_dict(self) -> dict[str, Any]:
        return {"type": self.type, **parameters_to_json(self)}


def step_all(
    models: Mapping[str, ActorModel],
    actors: Mapping[str, Actor],
    motions: Mapping[str, ActorMotion],
    traffic: Traffic,
    time_us: int,
    step_us: int,
) -> dict[str, ActorMotion]:
    """Return the motions of all that have models at ``time_us + step_us``, each against the ``traffic`` at ``time_us``."""
    answers = {uid: model.answer(actors[uid], motions[uid], traffic, time_us, step_us) for uid, model in models.items()}
    pending = [answer for answer in answers.values() if isinstance(answer, Pending)]
    leads = iter(find_leads([answer.search for answer in pending], traffic))
    return {uid: answer.then(next(leads)) if isinstance(answer, Pending) else answer for uid, answer in answers.items()}


def after(answer: Answer, then: Callable[[ActorMotion], ActorMotion]) -> Answer:
    """Return an answer that is changed when it is known."""
    if isinstance(answer, ActorMotion):
        return then(answer)
    return Pending(answer.search, lambda lead: then(answer.then(lead)))


MODELS: Registry[type[Model]] = Registry("an actor model", key="type")
"""The registered models by their names in documents."""
ModelT = TypeVar("ModelT", bound=type[Model])


def register(kind: ModelT) -> ModelT:
    """Register a model: documents that have it can then be read. Raises `TypeError` for an incomplete class,
    `ValueError` for a name that is taken."""
    state_members(kind, "model")
    MODELS.register(kind)
    return kind


def model_from_dict(document: Any, place: str = "model") -> Model:
    """Return the model of a JSON object. Raises `ScenarioError`, which names ``place`` and the member."""
    if not isinstance(document, dict):
        raise ScenarioError(f"{place}: must be an object, not {document!r}")
    name = document.get("type")
    if not isinstance(name, str) or name not in MODELS:
        raise ScenarioError(f"{place}.type: must be one of {', '.join(MODELS)}, not {name!r}")
    kind = MODELS[name]
    check_parameters(document, model_schema(kind), place)
    hints = get_type_hints(kind)
    values = {key: _build(hints[key], value) for key, value in document.items() if key != "type"}
    try:
        return kind(**values)
    except ScenarioError as error:
        raise ScenarioError(f"{place}.{str(error).removeprefix(f'{name}.')}") from None


def model_schema(kind: type[Model]) -> Schema:
    """Return the JSON Schema of one model's document."""
    properties = {"type": {"const": kind.type}, **kind.members}
    return members_of(properties, ["type", *required_fields(kind)], about_of(kind))


def models_schema() -> Schema:
    """Return the JSON Schema of a document of any registered model."""
    return choice_of({name: model_schema(kind) for name, kind in MODELS.items()})


def parameters_to_json(value: Any) -> Any:
    """Return parameters as JSON values; members that are None are left out of what is not a model itself."""
    if isinstance(value, Model):
        return {field.name: parameters_to_json(getattr(value, field.name)) for field in fields(value)}
    if is_dataclass(value):
        members = {field.name: getattr(value, field.name) for field in fields(value)}
        return {name: member for name, member in members.items() if member is not None}
    return [parameters_to_json(item) for item in value] if isinstance(value, tuple) else value


def _build(hint: Any, value: Any) -> Any:
    """Return a JSON value that a schema accepted as one of the annotated type."""
    if isinstance(value, list):
        return tuple(_build(get_args(hint)[0], item) for item in value)
    if isinstance(value, dict):
        return hint(**value)
    return int(value) if hint is int else value  # JSON Schema counts 2.0 among the integers
