"""The plan of a sequence: drive, captures and settings; and the identity of each capture, by which finished ones are known to
be up to date.

An identity is a digest of all that a capture's bytes depend on: the state of the world that its sensor can see, the
sensor, the trained scenes and meshes that the state names, the settings of its kind of sensor, the code that renders,
and the machine. An edit changes the identity of the captures that can see it, and of no other.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from ..render.captures import CaptureStates
from ..render.code_identity import code_identity
from ..scenes.recipe import RendererRecipe
from ..sensors.error_bound import parse_bounds, sample_frames
from ..sensors.rays import exposure_window
from ..world.captures import Capture, CaptureKey, Moment
from ..world.drive import Camera, Drive, Lidar
from ..world.drive_json import LIDAR_TABLES, drive_to_json
from ..world.replay import WorldState


@dataclass(frozen=True)
class SequenceSettings:
    """How captures are rendered. Which captures those are is not part of it, because it changes no
    capture's content."""

    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    passes: tuple[str, ...] = ("rgb",)
    formats: tuple[str, ...] = ("png", "exr", "ply", "npz", "labels")
    width: int | None = None
    quality: str = "balanced"
    device: str = "cpu"
    draw: int | None = None
    """Seed of the draw that decides which beams return; None takes those with a probability of half or more."""
    contact_shadows: bool = False
    max_error: tuple[str, ...] = ()
    """Error bounds that every frame must keep; ``quality`` then holds for sensors without a bound."""
    renderer: str = "neural"
    fill: str = "none"
    """What is shown where nobody saw: one of `frames.FILLS`, or a fixer (`render.fixers`)."""
    detail: bool = False
    """Whether images get the detail of recorded ones near by (`render.recorded_detail`)."""


@dataclass(frozen=True)
class RenderPlan:
    """A sequence to render: the ``moments`` of a drive.

    recipe: makes the renderer, once in every process.
    scenes: hashes of trained scenes and meshes by their names in `Appearance` ("" is the drive's own scene).
    environment: machine, instruction set, versions of the libraries that compute. With ``scenes``, ``settings`` and the
    state of the world it decides whether a capture is up to date. captures: gives the state of the world that a capture
    depends on. about: further entries of the manifest: names and hashes, no paths, so that the manifest does not depend
    on where files lie.
    """

    drive: Drive
    moments: tuple[Moment, ...]
    settings: SequenceSettings
    recipe: RendererRecipe
    scenes: dict[str, str]
    environment: dict[str, str]
    about: dict[str, Any]
    captures: CaptureStates

    @property
    def frames(self) -> tuple[int, ...]:
        """Numbers of the moments that are frames of the log."""
        return tuple(moment.frame for moment in self.moments if moment.frame is not None)

    def moment_of_frame(self, frame: int) -> Moment:
        """Return the moment of a frame of the log, whether it is part of the plan or not."""
        return Moment.of_frame(self.drive, frame, self.settings.cameras, self.settings.lidars)


CAMERA_FORMATS, LIDAR_FORMATS = ("png", "exr"), ("ply", "npz")
NOT_OF_CAMERAS, NOT_OF_LIDARS = ("draw",), ("passes", "width", "contact_shadows", "detail")
"""Settings that change no image, and no sweep."""


Identity = tuple[str, tuple[str, ...]]
"""A digest of 64 hexadecimal digits, and the ids of the actors that the capture can see."""


class CaptureIdentities:
    """The identities of a plan's captures."""

    def __init__(self, plan: RenderPlan) -> None:
        self.plan = plan
        self._of_moments: dict[CaptureKey, dict[str, Identity]] = {}
        bounds = parse_bounds(plan.settings.max_error)
        self._of_colour = any(bound.unit != "mm" for bound in bounds)
        self._camera, self._lidar = (
            self._common(NOT_OF_CAMERAS, CAMERA_FORMATS, [str(bound) for bound in bounds if bound.unit != "mm"]),
            self._common(NOT_OF_LIDARS, LIDAR_FORMATS, [str(bound) for bound in bounds if bound.unit == "mm"]),
        )

    def of_moment(self, moment: Moment) -> dict[str, Identity]:
        """Return the identities of a moment's captures, by name, cameras first."""
        if moment.key not in self._of_moments:
            sensors, width = self.plan.drive.sensors, self.plan.settings.width
            identities = {}
            for name, capture in moment.captures.items():
                sensor = sensors[capture.sensor_id]
                if width and isinstance(sensor, Camera):
                    sensor = sensor.resized(width)  # cells of a smaller image reach farther beyond its edges
                identities[name] = self.of(sensor, capture)
            self._of_moments[moment.key] = identities
        return self._of_moments[moment.key]

    def of_frame(self, frame: int) -> dict[str, Identity]:
        """Return the identities of the captures that a frame of the log has, by name, cameras first."""
        return self.of_moment(self.plan.moment_of_frame(frame))

    def of(self, sensor: Camera | Lidar, capture: Capture) -> Identity:
        state = self._state(sensor, capture)
        digest = hashlib.sha256(self._camera if isinstance(sensor, Camera) else self._lidar)
        for part in _sensor_parts(sensor, capture):
            digest.update(part)
        digest.update(self._digest(state))
        if isinstance(sensor, Camera) and self._of_colour:
            # settings are chosen by pixels of frames all over the drive
            for other in sample_frames(sensor.time_s):
                digest.update(self._digest(self._state(sensor, Capture.of_frame(sensor, other))))
        return digest.hexdigest(), tuple(actor.uid for actor in state.actors)

    def _state(self, sensor: Camera | Lidar, capture: Capture) -> WorldState:
        return self.plan.captures.state(sensor, capture.time_s(sensor))

    def _digest(self, state: WorldState) -> bytes:
        """Return the state's digest, with digests in place of the paths of scenes and meshes: where they lie
        changes nothing."""
        digests = self.plan.scenes
        appearances = [
            replace(
                a.appearance,
                **{
                    kind: digests.get(path, path) for kind in ("scene", "mesh") if (path := getattr(a.appearance, kind))
                },
            )
            for a in state.actors
        ]
        actors = (
            replace(actor, appearance=appearance) for actor, appearance in zip(state.actors, appearances, strict=True)
        )
        return replace(state, actors=tuple(actors)).digest.encode()

    def _common(self, left_out: tuple[str, ...], formats: tuple[str, ...], bounds: list[str]) -> bytes:
        """Return what all captures of a kind of sensor share."""
        plan = self.plan
        settings = {
            **{
                name: value
                for name, value in asdict(plan.settings).items()
                if name not in ("cameras", "lidars", *left_out)
            },
            "formats": [name for name in plan.settings.formats if name in formats],
            "max_error": bounds,
        }
        document: dict[str, Any] = {
            "scene": plan.scenes.get(""),
            "settings": settings,
            "code": code_identity(),
            "environment": plan.environment,
            # of renderers whose frames depend on all of it
            "drive": {**drive_to_json(plan.drive), "frames": None} if plan.captures.sees_all else None,
        }
        return json.dumps(document, sort_keys=True).encode()


def _sensor_parts(sensor: Camera | Lidar, capture: Capture) -> Iterator[bytes]:
    frame, time_s = capture.frame, capture.time_s(sensor)
    if isinstance(sensor, Camera):
        model = sensor.model_at(time_s).to_dict()
    else:
        model = {name: value for name, value in asdict(sensor.model).items() if not hasattr(value, "tobytes")}
        model = {name: value for name, value in model.items() if value is not None}
    about = {"sensor": sensor.sensor_id, "frame": frame, "time_s": time_s, "model": model, "body": sensor.sees_ego_body}
    yield json.dumps(about, sort_keys=True).encode()
    window = exposure_window(sensor, time_s)
    yield sensor.trajectory.between(*window).content()
    if isinstance(sensor, Camera):
        return
    yield sensor.model.elevation_rad.tobytes()
    yield sensor.model.azimuth_offset_rad.tobytes()
    yield b"" if sensor.blocked is None else sensor.blocked.tobytes()
    # as JSON, not as bytes in a row: one table is not taken for another
    tables = {name: getattr(sensor.model, name) for name in LIDAR_TABLES if getattr(sensor.model, name) is not None}
    if tables or sensor.phase is not None:
        turned = None if sensor.phase is None else sensor.phase.at(time_s)
        yield json.dumps(
            {"tables": {k: v.tolist() for k, v in tables.items()}, "turned": turned}, sort_keys=True
        ).encode()
