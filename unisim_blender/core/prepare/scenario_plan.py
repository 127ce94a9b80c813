"""Plan what a scenario renders: its own options, and over them the command line's."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ScenarioError, UnisimError
from ..formats.readers import open_log
from ..render.code_identity import code_identity
from ..render.fixers import fixer_digest, fixer_named
from ..render.recorded_detail import training_images
from ..scenario import scenario_to_json
from ..scenario.times import carried_outside, parse_times, scenario_times_us, with_times
from ..scenario.types import FRAME_FORMATS, SEQUENCE_FORMATS, Outputs, Scenario
from ..scenes.recipe import RendererRecipe, RenderMethod, environment, scenes_of, used_device
from ..scenes.scene import OpenScenes, Scene, capability_warnings
from ..sensors.error_bound import ErrorBound
from ..sensors.frames import CAMERA_PASSES
from ..sequence.plan import RenderPlan, SequenceSettings
from ..world.captures import Moment, moments_of
from ..world.drive import Drive
from .renderers import UNTRAINED_DEFAULT, renderer_of, renderers_with
from .scenario import PreparedScenario, prepare_scenario
from .selection import check_names, select_frames


@dataclass(frozen=True)
class RenderOptions:
    """Options of the command line; None leaves one to the scenario, and then to the defaults."""

    frames: str | None = None
    times: str | None = None
    sensors: tuple[str, ...] | None = None
    passes: tuple[str, ...] | None = None
    width: int | None = None
    quality: str | None = None
    device: str = "cpu"
    draw: int | None = None
    max_error: tuple[ErrorBound, ...] = ()
    renderer: str | None = None
    sources: str | None = None
    scene: Path | str | None = None
    boxes: Path | None = None
    fill: str | None = None
    detail: bool | None = None


def plan_scenario(
    source: Path | str | Scenario, options: RenderOptions, scenes: OpenScenes | None = None
) -> tuple[RenderPlan, PreparedScenario]:
    """Open a scenario, or a log alone, and say what to render of it: by the renderer that is wished for, else with its
    trained scene, and by surfels where it names none. ``source`` is its path or URL, or the
    scenario; ``scenes`` are those that were opened before. Raises `UnisimError`."""
    refined = options.renderer is None or renderers_with(options.renderer)[options.renderer].trained
    prepared = prepare_scenario(source, refined, options.scene, scenes, options.boxes)
    method = _method(source.path if isinstance(source, Scenario) else source, prepared, options)
    prepared, times = _at_times(prepared, options)
    drive, settings = prepared.edited, _settings(prepared, options, method)
    moments = _moments(drive, settings, options, times)
    recipe = _recipe(prepared, options, settings, method)
    return (
        RenderPlan(
            drive=drive,
            moments=moments,
            settings=settings,
            recipe=recipe,
            scenes=method.digests(recipe, drive),
            environment={**recipe.environment, **fixer_digest(settings.fill)},
            about=_about(prepared, recipe.scene, settings, options),
            captures=method.states(recipe, drive),
        ),
        prepared,
    )


def _method(source: Path | str, prepared: PreparedScenario, options: RenderOptions) -> RenderMethod:
    """Return the renderer that is asked for, or else that of the trained scene, or surfels. Raises `ScenarioError`."""
    name = options.renderer or (UNTRAINED_DEFAULT.name if prepared.scene is None else renderer_of(prepared.scene))
    method = renderers_with(name)[name]
    if method.trained and prepared.scene is None:
        raise ScenarioError(
            f'{source}: scene: names no trained scene to render with; give one with --scene, or train one with "unisim train"'
        )
    if options.sources is not None and method.trained:
        raise ScenarioError(
            f'{source}: what the renderer "{name}" learnt from was chosen when it was trained, not by --sources'
        )
    return method


SensorTimes = tuple[tuple[int, ...] | None, dict[str, tuple[int, ...]]]
"""Times in microseconds of all sensors, None for the log's frames; and those of sensors with times of their own."""


def _at_times(prepared: PreparedScenario, options: RenderOptions) -> tuple[PreparedScenario, SensorTimes]:
    """Return the times to render, and the scenario with a drive that goes on to them. Raises `UnisimError`."""
    if options.frames is not None and options.times is not None:
        raise UnisimError(f"--frames {options.frames} and --times {options.times}: give one of the two")
    scenario = prepared.scenario
    if options.frames is not None or options.times is not None:
        scenario = with_times(scenario, None if options.times is None else parse_times(options.times))
    times, of_sensors = scenario_times_us(scenario, prepared.edited)
    every_time = {*(times or ()), *(time for own in of_sensors.values() for time in own)}
    edited = carried_outside(prepared.edited, scenario, every_time)
    return prepared._replace(edited=edited), (times, of_sensors)


def _settings(prepared: PreparedScenario, options: RenderOptions, method: RenderMethod) -> SequenceSettings:
    """Return how captures are rendered: by the options, else the scenario, else the defaults. Raises `UnisimError`."""
    drive, outputs = prepared.edited, prepared.scenario.outputs or Outputs()
    # a log's plain points, without a beam table, are no sensor that could be simulated
    there = (*drive.cameras, *(name for name, lidar in drive.lidars.items() if lidar.model.beams))
    sensors = there if options.sensors is None else options.sensors
    check_names("sensor", sensors, there)
    passes = options.passes or outputs.passes or ("rgb",)
    check_names("pass", passes, CAMERA_PASSES)
    return SequenceSettings(
        cameras=tuple(name for name in drive.cameras if name in sensors),
        lidars=tuple(name for name in drive.lidars if name in sensors),
        # rgb is always there: it is what the image's files hold
        passes=tuple(name for name in CAMERA_PASSES if name in passes or name == "rgb"),
        formats=tuple(name for name in FRAME_FORMATS if name in (outputs.formats or FRAME_FORMATS)),
        width=options.width or outputs.width,
        quality=options.quality or outputs.quality or "balanced",
        device=_device(prepared, options, method),
        draw=options.draw,
        contact_shadows=bool(outputs.contact_shadows),
        fill=_fill(prepared, options, method),
        detail=_detail(prepared, options, method),
        max_error=tuple(map(str, options.max_error)),
        renderer=method.name,
    )


def _fill(prepared: PreparedScenario, options: RenderOptions, method: RenderMethod) -> str:
    """Return how what nobody saw is filled. Raises `UnisimError`."""
    fill = options.fill or (prepared.scenario.outputs or Outputs()).fill or "none"
    if fill != "none" and not method.trained:
        raise UnisimError(
            f"--fill {fill}: fills what trained scenes do not know, not the images of --renderer {method.name}"
        )
    fixer_named(fill)  # a name that is none is refused before anything runs
    return fill


def _detail(prepared: PreparedScenario, options: RenderOptions, method: RenderMethod) -> bool:
    """Return whether images get the detail of recorded ones. Raises `UnisimError`."""
    detail = options.detail
    if detail is None:
        detail = bool((prepared.scenario.outputs or Outputs()).detail)
    if detail and not method.trained:
        raise UnisimError(
            f"--detail: adds what renders of trained scenes lack, not to images of --renderer {method.name}"
        )
    if detail and not prepared.log_path.exists():
        raise UnisimError(f"{prepared.log_path}: is not there; --detail needs the images that the scene was trained on")
    if detail and prepared.scene is not None:
        header = prepared.scene.header
        training_images(header.drive, header.training, open_log(prepared.log_path))
    return detail


def _device(prepared: PreparedScenario, options: RenderOptions, method: RenderMethod) -> str:
    """Return what renders: the CPU, for renderers and scenes that a GPU does not take. Raises `UnisimError`."""
    if not method.trained:
        return "cpu"
    return used_device(options.device, scenes_of(prepared.scene, prepared.scenes.others(prepared.edited)))


def _moments(
    drive: Drive, settings: SequenceSettings, options: RenderOptions, times: SensorTimes
) -> tuple[Moment, ...]:
    frames = drive.frames if options.frames is None else select_frames(options.frames, sorted(drive.time_s))
    return moments_of(drive, frames, times[0], settings.cameras, settings.lidars, times[1])


def _recipe(
    prepared: PreparedScenario, options: RenderOptions, settings: SequenceSettings, method: RenderMethod
) -> RendererRecipe:
    """Return how the renderer is made, here or in another process. Raises `UnisimError`."""
    recorded, drive = prepared.recorded, prepared.edited
    sources = None if options.sources is None else select_frames(options.sources, recorded.frames, "--sources")
    if options.max_error and not method.trained:
        raise UnisimError(
            f"--max-error {options.max_error[0]}: holds for trained scenes, not for --renderer {method.name}"
        )
    scene, others = prepared.scene if method.trained else None, prepared.scenes.others(drive)
    method.check_inputs(prepared.log_path, scene)
    return RendererRecipe(
        method=method,
        log=prepared.log_path,
        scene=scene,
        others=others,
        world_origin=drive.world_origin,
        quality=settings.quality,
        device=settings.device,
        shadows=settings.contact_shadows,
        frames=sources,
        code=code_identity()["sha256"],
        environment=environment(settings.device, scenes_of(scene, others)),
        fill=settings.fill,
        detail=settings.detail,
    )


def _about(
    prepared: PreparedScenario, scene: Scene | None, settings: SequenceSettings, options: RenderOptions
) -> dict[str, Any]:
    """Return the manifest's entries on what is rendered, and what of it comes out otherwise than asked."""
    drive = prepared.edited
    about: dict[str, Any] = {
        "scenario": {"name": prepared.scenario.name, "sha256": scenario_hash(prepared.scenario)},
        "log": {"name": drive.name, "world_origin": drive.world_origin.tolist()},
    }
    warnings = (
        [] if scene is None else capability_warnings(scene, prepared.recorded, drive, sweeps=bool(settings.lidars))
    )
    if settings.device != options.device:
        what = f"the renderer {settings.renderer!r}" if scene is None else f"scene {scene.header.name!r}"
        warnings.append(f"{what} has no kernels for --device {options.device}: the CPU renders")
    return about | ({"warnings": warnings} if warnings else {})


def sequence_formats(scenario: Scenario) -> tuple[str, ...]:
    """The formats of `SEQUENCE_FORMATS` that a scenario asks for."""
    wanted = (scenario.outputs or Outputs()).formats or ()
    return tuple(name for name in SEQUENCE_FORMATS if name in wanted)


def scenario_hash(scenario: Scenario) -> str:
    """A digest of the document, whatever its layout, and wherever it, its log and its scenes lie."""
    document = scenario_to_json(scenario)
    for part in (document, *document.get("edits", ())):
        for path in ("log", "scene", "mesh"):
            part.pop(path, None)
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
