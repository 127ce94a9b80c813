"""Weather of a scenario's document: numbers, or keys over time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Annotated, Union

from ..world.captures import microseconds
from ..world.weather import AS_RECORDED_DEG, KEYED, Receiver, Weather, WeatherKeys
from .checks import require
from .json_schema import NUMBER, POSITIVE, Schema, SchemaOf, members_of, object_of

MIN_VISIBILITY_M, MAX_VISIBILITY_M = 5.0, 1e6
MIN_ELEVATION_DEG = -18.0
MAX_LAMP_HEIGHT_M = 50.0
LAMP: Schema = {
    "type": "array", "minItems": 3, "maxItems": 3, "prefixItems": [NUMBER, NUMBER, {**POSITIVE, "maximum": MAX_LAMP_HEIGHT_M}]
}  # fmt: skip


@dataclass(frozen=True)
class ValueKey:
    """A value at a time, seconds from the log's first frame."""

    time_s: float
    value: float


def keyed(about: str, **limits: float) -> SchemaOf:
    """Return the schema of a number within limits, or of keys with such numbers."""
    value = {**NUMBER, **limits}
    keys = {
        "type": "array",
        "minItems": 1,
        "items": members_of({"time_s": NUMBER, "value": value}, ["time_s", "value"]),
    }
    return SchemaOf({"if": {"type": "array"}, "then": keys, "else": value, "description": about})


def _number(about: str, least: float, most: float) -> SchemaOf:
    return SchemaOf({**NUMBER, "minimum": least, "maximum": most, "description": about})


Keyed = Union[float, tuple[ValueKey, ...]]  # noqa: UP007 read at run time


@dataclass(frozen=True)
class ReceiverSpec:
    """What weather needs to know of the sensors; a missing value is `Receiver`'s."""

    pulse_ns: Annotated[float, _number("Half-power width of a LiDAR's pulse.", 0.1, 100)] | None = None
    divergence_mrad: Annotated[float, _number("Full angle of a LiDAR's beam.", 0.01, 50)] | None = None
    threshold: (
        Annotated[float, _number("Reflectivity that a LiDAR just measures at its largest range.", 1e-6, 1)] | None
    ) = None
    overlap_m: (
        Annotated[float, _number("Distance from which a LiDAR receives all of a beam's light.", 0.01, 100)] | None
    ) = None
    exposure_s: Annotated[float, _number("Exposure time of a camera's pixel.", 1e-5, 0.1)] | None = None


@dataclass(frozen=True)
class WeatherSpec:
    """Weather, in cameras and LiDARs; each value is a number, or a list of keys over time."""

    visibility_m: (
        Annotated[
            Keyed,
            keyed("Fog: the distance at which contrast is 2 %.", minimum=MIN_VISIBILITY_M, maximum=MAX_VISIBILITY_M),
        ]
        | None
    ) = None
    rain_mm_h: Annotated[Keyed, keyed("Rain.", minimum=0, maximum=200)] | None = None
    snow_mm_h: Annotated[Keyed, keyed("Snow, as liquid water.", minimum=0, maximum=20)] | None = None
    wetness: Annotated[Keyed, keyed("Wet part of the ground; rain adds to it.", minimum=0, maximum=1)] | None = None
    sun_elevation_deg: (
        Annotated[
            Keyed,
            keyed(
                "Time of day, a look of images: the sun's height above the horizon; 90: as recorded.",
                minimum=MIN_ELEVATION_DEG, maximum=AS_RECORDED_DEG,
            ),
        ]
        | None
    ) = None  # fmt: skip
    street_lamps: (
        Annotated[
            tuple[tuple[float, float, float], ...],
            SchemaOf({"type": "array", "items": LAMP, "description": "Lamps by night: x, y, height above the ground."}),
        ]
        | None
    ) = None
    seed: Annotated[int, SchemaOf({"type": "integer", "minimum": 0, "maximum": 2**31 - 1})] | None = None
    sensors: ReceiverSpec | None = None


DEFS: dict[str, Schema] = {
    "weather": object_of(WeatherSpec, "Weather over time, in cameras and LiDARs."),
    "receiver": object_of(ReceiverSpec),
}


def check_weather(spec: WeatherSpec, place: str) -> None:
    """Raise `ScenarioError` for keys that are not in order."""
    check_keys(spec, KEYED, place)


def check_keys(spec: object, names: Iterable[str], place: str) -> None:
    """Raise `ScenarioError` for keys of members that are not in order."""
    for name in names:
        keys = getattr(spec, name)
        for index in range(1, len(keys) if isinstance(keys, tuple) else 0):
            before, now = keys[index - 1].time_s, keys[index].time_s
            problem = f"{now:g} s must lie after the key before, {before:g} s, by a microsecond"
            require(microseconds(now) > microseconds(before), f"{place}.{name}[{index}].time_s", problem)


def keys_of(spec: object, names: Iterable[str]) -> dict[str, tuple[tuple[float, float], ...]]:
    """Return the keys (time in seconds, value) of those members that a document states."""
    stated = {name: value for name in names if (value := getattr(spec, name)) is not None}
    return {
        name: tuple((key.time_s, key.value) for key in value) if isinstance(value, tuple) else ((0.0, value),)
        for name, value in stated.items()
    }


def weather_of(spec: WeatherSpec) -> WeatherKeys:
    """Return the weather that a document states."""
    keys = keys_of(spec, KEYED)
    sensors = {} if spec.sensors is None else asdict(spec.sensors)
    receiver = Receiver(**{name: value for name, value in sensors.items() if value is not None})
    return WeatherKeys(keys, Weather(seed=spec.seed or 0, receiver=receiver, street_lamps=spec.street_lamps or ()))
