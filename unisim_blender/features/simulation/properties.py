"""Properties of a scene's simulation and of its actors' models.

Settings that a scenario states are read from and written to JSON documents in text: what no setting shows is kept, and
numbers that nobody changed stay as they were written.
"""

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ...editing.simulation import stated
from ...editing.simulation.menus import DEFAULT, OWN, RendererItem, driver_items, is_function, is_remote, renderer_items
from ...editing.texts import translatable
from ..drive.properties import RELATIVE

KINDS = stated.kinds()
NO_MODEL = ("NONE", "As All Others", "The model of all actors that have none of their own")
DRIVERS = driver_items()
PARAMETERS: dict[str, tuple[str, str, str]] = {
    "headway_s": (translatable("Headway"), translatable("Time gap to the vehicle ahead"), "TIME_ABSOLUTE"),
    "gap_m": (translatable("Gap"), translatable("Distance to what is ahead at rest"), "LENGTH"),
    "acceleration_m_s2": (translatable("Acceleration"), translatable("Largest acceleration"), "ACCELERATION"),
    "braking_m_s2": (translatable("Braking"), translatable("Comfortable deceleration"), "ACCELERATION"),
    "exponent": (
        translatable("Exponent"),
        translatable("A larger exponent keeps the acceleration up until nearer the desired speed"),
        "NONE",
    ),
    "departure_m": (
        translatable("Departure"),
        translatable("Distance of the ego vehicle from its recorded place from which on it has left its log"),
        "LENGTH",
    ),
    "horizon_s": (translatable("Horizon"), translatable("Time within which conflicts are foreseen"), "TIME_ABSOLUTE"),
    "cut_in_gap_m": (
        translatable("Cut-in gap"),
        translatable("It changes where it is ahead of the ego vehicle by this distance or more"),
        "LENGTH",
    ),
    "cut_in_headway_s": (
        translatable("Cut-in headway"),
        translatable("It changes where it is ahead of the ego vehicle by this time or less"),
        "TIME_ABSOLUTE",
    ),
    "duration_s": (translatable("Change takes"), translatable("Time that the change takes"), "TIME_ABSOLUTE"),
    "speed_difference_m_s": (
        translatable("Speed difference"),
        translatable("Its speed after the change, compared with the ego vehicle"),
        "VELOCITY",
    ),
    "range_m": (translatable("Range"), translatable("Distance from the ego vehicle within which it attacks"), "LENGTH"),
    "forecast_s": (translatable("Forecast"), translatable("Time over which drives are compared"), "TIME_ABSOLUTE"),
    "decide_s": (translatable("Decides every"), translatable("Time between two decisions"), "TIME_ABSOLUTE"),
    "best": (translatable("Draws among"), translatable("Number of best drives from which one is drawn"), "NONE"),
    "neighbour_cost_m": (
        translatable("Cost of others"),
        translatable("Cost of meeting another box, as a distance"),
        "LENGTH",
    ),
    "along_m_s2": (
        translatable("Acceleration along"),
        translatable("Largest acceleration along its path"),
        "ACCELERATION",
    ),
    "across_m_s2": (
        translatable("Acceleration across"),
        translatable("Largest acceleration to the side"),
        "ACCELERATION",
    ),
    "most_speed_m_s": (translatable("Top speed"), translatable("Largest speed of an attack"), "VELOCITY"),
}
"""Name, description and unit of the models' parameters."""


def _index(items: Any, name: str) -> int:
    return next((number for number, item in enumerate(items) if item[0] == name), 0)


def _kind(self: Any) -> int:
    return 1 + _index(KINDS, stated.kind_of(self.document)) if self.document else 0


def _set_kind(self: Any, number: int) -> None:
    if number != _kind(self):
        self.document = stated.with_kind(self.document, KINDS[number - 1][0]) if number else ""


def _set_kind_of_others(self: Any, number: int) -> None:
    if KINDS[number][0] != stated.kind_of(self.document):
        self.document = stated.with_kind(self.document, KINDS[number][0])


class UniSimModel(bpy.types.PropertyGroup):
    """The model of an actor in simulations."""

    document: StringProperty(options={"HIDDEN"})
    kind: EnumProperty(
        name="Model",
        description="Model that moves the actor in simulations",
        items=[NO_MODEL, *KINDS],
        get=_kind,
        set=_set_kind,
        options=set(),
    )
    kind_of_others: EnumProperty(
        name="All others",
        description="Model of all moving actors that have none of their own",
        items=KINDS,
        get=lambda self: _index(KINDS, stated.kind_of(self.document)),
        set=_set_kind_of_others,
        options=set(),
    )
    keys: StringProperty(
        name="Keys",
        description="Seconds, speed in m/s, metres to the left of the path; '-' for none: 0 5, 2 8, 3 - 1.5",
        get=lambda self: stated.keys_text(self.document),
        set=lambda self, line: setattr(self, "document", stated.with_keys(self.document, line)),
        options=set(),
    )


def _parameter(member: str, name: str, description: str, unit: str) -> Any:
    """Return a property that shows a parameter of the model's document."""

    def read(self: Any) -> float:
        return stated.value_of(self.document, member)

    def write(self: Any, value: float) -> None:
        if abs(value - read(self)) > 1e-6 * max(abs(value), 1e-3):
            self.document = stated.with_value(self.document, member, value)

    if member == "best":
        return IntProperty(
            name=name, description=description, min=1, get=lambda self: int(read(self)), set=write, options=set()
        )
    low = -100.0 if member == "speed_difference_m_s" else 0.0
    return FloatProperty(
        name=name, description=description, min=low, get=read, set=write, unit=unit, step=10, precision=2, options=set()
    )


for _member, _about in PARAMETERS.items():
    UniSimModel.__annotations__[_member] = _parameter(_member, *_about)


def _number(member: str, **about: Any) -> Any:
    """Return a property that shows a number of the simulation's text."""
    kind = IntProperty if member == "seed" else FloatProperty
    _, low, high = stated.SETTINGS[member]

    def read(self: Any) -> float:
        value = stated.number_of(self.document, member)
        return int(value) if member == "seed" else value

    def write(self: Any, value: float) -> None:
        self.document = stated.with_number(self.document, member, value)

    return kind(min=low, max=high, get=read, set=write, options=set(), **about)


def _switch(member: str, **about: Any) -> Any:
    """Return a property that says whether the simulation's text states a member."""

    def write(self: Any, value: bool) -> None:
        if value and not stated.states(self.document, member):
            self.document = stated.with_default(self.document, member)
        elif not value:
            self.document = stated.without(self.document, member)

    return BoolProperty(get=lambda self: stated.states(self.document, member), set=write, options=set(), **about)


def _set_driver(self: Any, number: int) -> None:
    self.driver = DRIVERS[number][0]


def _renderer_items(self: Any, context: bpy.types.Context | None) -> list[RendererItem]:
    """Return the renderers of the scene's log."""
    return renderer_items(bpy.path.abspath(self.id_data.unisim.log))


class UniSimSimulation(bpy.types.PropertyGroup):
    """The simulation of a scene. ``rollout`` is the folder of the rollout that the scene was opened from, ``span_s``
    its first and last time, ``state`` that of its files then; ``scored`` the one whose scores are shown; ``hidden`` are
    names of rollouts that the list leaves out, with "/" between."""

    document: StringProperty(options={"HIDDEN"})
    others: PointerProperty(type=UniSimModel)
    driver: StringProperty(default=DEFAULT, options={"HIDDEN"})
    choice: EnumProperty(
        name="Driver",
        description="Driver of the ego vehicle",
        items=DRIVERS,
        get=lambda self: _index(DRIVERS, self.driver),
        set=_set_driver,
        options=set(),
    )
    function: StringProperty(
        name="Function",
        description="module:function of a DriverSetup that returns a driver, in a module that Python finds",
    )
    address: StringProperty(
        name="Address", description="Where the process of the driver listens: HOST:PORT, or unix:PATH"
    )
    renderer: EnumProperty(
        name="Renderer", description="Renderer of images and sweeps", items=_renderer_items, default=0
    )
    out: StringProperty(
        name="Folder",
        description="Folder of rollouts; each gets its own in it",
        subtype="DIR_PATH",
        default="//rollouts",
        options=RELATIVE,
    )
    rollout: StringProperty(options={"HIDDEN"})
    span_s: bpy.props.FloatVectorProperty(size=2, options={"HIDDEN"})
    state: StringProperty(options={"HIDDEN"})
    scored: StringProperty(options={"HIDDEN"})
    hidden: StringProperty(options={"HIDDEN"})
    show_plans: BoolProperty(
        name="Plans", description="Draw the plan of the driver at the current frame of an opened rollout", default=True
    )
    show_ghost: BoolProperty(
        name="Recorded Drive",
        description="Draw the recorded boxes of what an opened rollout has elsewhere, and the recorded path of the vehicle",
        default=True,
    )


for _name, _property in {
    "starts": _switch(
        "start_s", name="Start at", description="Start at a time of the drive; else at its first frame"
    ),
    "start_s": _number("start_s", name="Start", description="Seconds of the log", unit="TIME_ABSOLUTE", precision=3),
    "ends": _switch(
        "duration_s", name="Limit duration", description="Simulate for some time; else to the last frame of the drive"
    ),
    "duration_s": _number(
        "duration_s", name="Duration", description="Simulated time", unit="TIME_ABSOLUTE", precision=2
    ),
    "step_s": _number(
        "step_s", name="Step", description="Time between two answers of the driver", unit="TIME_ABSOLUTE", precision=3
    ),
    "delay_s": _number(
        "delay_s", name="Delay",
        description="Delay until an answer of the driver takes effect, a multiple of the step",
        unit="TIME_ABSOLUTE", precision=3,
    ),
    "seed": _number("seed", name="Seed", description="Of all random numbers: starts and actors"),
    "jitter_along": _number(
        "jitter.ego_along_m", name="Along",
        description="Largest displacement of the start of the ego vehicle, ahead or behind",
        unit="LENGTH", precision=2,
    ),
    "jitter_aside": _number(
        "jitter.ego_aside_m", name="Aside",
        description="Largest displacement of the start of the ego vehicle, to the left or right",
        unit="LENGTH", precision=2,
    ),
    "jitter_yaw": _number(
        "jitter.ego_yaw_deg", name="Turned (°)",
        description="Largest rotation of the ego vehicle at its start, in degrees",
        precision=1,
    ),
    "jitter_speed": _number(
        "jitter.ego_speed_m_s", name="Speed",
        description="Largest change of the speed of the ego vehicle at its start, faster or slower",
        unit="VELOCITY", precision=2,
    ),
    "jitter_actors": _number(
        "jitter.actors_s", name="Actors", description="Largest shift in time of the start of an actor, earlier or later",
        unit="TIME_ABSOLUTE", precision=2,
    ),
}.items():  # fmt: skip
    UniSimSimulation.__annotations__[_name] = _property


def driver_of(scene: bpy.types.Scene) -> str:
    """Return the driver as the command line takes it; "" where its function or its address is not named yet."""
    about = scene.unisim_simulation
    if about.choice != OWN:
        return str(about.choice) if not is_remote(about.choice) or about.address.strip() else ""
    function = about.function.strip()
    return function if is_function(function) else ""


PROPERTIES = (
    (bpy.types.Object, "unisim_model", PointerProperty(type=UniSimModel)),
    (bpy.types.Scene, "unisim_simulation", PointerProperty(type=UniSimSimulation)),
)
