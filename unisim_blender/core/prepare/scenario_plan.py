"""From a scenario's file to what is rendered: its own options, and over them the command line's."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ScenarioError, UnisimError
from ..output.frame_files import FORMATS
from ..render.code_identity import code_identity
from ..scenario import scenario_to_json
from ..scenario.times.outside import carried_outside
from ..scenario.times.ranges import parse_times, scenario_times_us, with_times
from ..scenario.types import Outputs, Scenario
from ..scenes.backends import environment
from ..scenes.recipe import RendererRecipe, scenes_of
from ..scenes.scene import OpenScenes
from ..sensors.error_bound import ErrorBound
from ..sensors.frames import CAMERA_PASSES
from ..sequence.plan import RenderPlan, SequenceSettings
from ..world.captures import moments_of
from .capabilities import capability_warnings
from .renderers import RENDERERS, UNTRAINED_DEFAULT, renderer_of
from .scenario import PreparedScenario, prepare_scenario
from .selection import check_names, select_frames

SEQUENCE_FORMATS = ("pandaset", "video", "mcap", "rosbag", "coco")
"""Formats that are made of a whole sequence, after its frames."""


@dataclass(frozen=True)
class RenderOptions:
    """What the command line asks for; None leaves it to the scenario, and then to the defaults."""

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


def plan_scenario(
    source: Path | str | Scenario, options: RenderOptions, scenes: OpenScenes | None = None
) -> tuple[RenderPlan, PreparedScenario]:
    """Open a scenario, or a log alone, and say what to render of it: by the renderer that is wished for, else with its
    trained scene, and by surfels where it names none. ``source`` is its path or URL, or the
    scenario; ``scenes`` are those that were opened before. Raises `UnisimError`."""
    path = source.path if isinstance(source, Scenario) else source
    refined = options.renderer is None or RENDERERS.with_plugins()[options.renderer].trained
    prepared = prepare_scenario(source, refined, options.scene, scenes)
    name = options.renderer or (UNTRAINED_DEFAULT.name if prepared.scene is None else renderer_of(prepared.scene))
    if RENDERERS.with_plugins()[name].trained and prepared.scene is None:
        raise ScenarioError(
            f'{path}: scene: names no trained scene to render with; give one with --scene, or train one with "unisim train"'
        )
    if options.sources is not None and RENDERERS.with_plugins()[name].trained:
        raise ScenarioError(
            f'{path}: what the renderer "{name}" learnt from was chosen when it was trained, not by --sources'
        )
    if options.frames is not None and options.times is not None:
        raise UnisimError(f"--frames {options.frames} and --times {options.times}: give one of the two")
    scenario = prepared.scenario
    if options.frames is not None or options.times is not None:
        scenario = with_times(scenario, None if options.times is None else parse_times(options.times))
    times, of_sensors = scenario_times_us(scenario, prepared.edited)
    every_time = {*(times or ()), *(time for own in of_sensors.values() for time in own)}
    prepared = prepared._replace(edited=carried_outside(prepared.edited, scenario, every_time))
    drive, outputs = prepared.edited, scenario.outputs or Outputs()
    # a log's plain points, without a beam table, are no sensor that could be simulated
    there = (*drive.cameras, *(name for name, lidar in drive.lidars.items() if lidar.model.beams))
    sensors = there if options.sensors is None else options.sensors
    check_names("sensor", sensors, there)
    passes = options.passes or outputs.passes or ("rgb",)
    check_names("pass", passes, CAMERA_PASSES)
    quality = options.quality or outputs.quality or "balanced"
    settings = SequenceSettings(
        cameras=tuple(name for name in drive.cameras if name in sensors),
        lidars=tuple(name for name in drive.lidars if name in sensors),
        # rgb is always there: it is what the image's files hold
        passes=tuple(name for name in CAMERA_PASSES if name in passes or name == "rgb"),
        formats=tuple(name for name in FORMATS if name in (outputs.formats or FORMATS)),
        width=options.width or outputs.width,
        quality=quality,
        device=options.device,
        draw=options.draw,
        contact_shadows=bool(outputs.contact_shadows),
        max_error=tuple(map(str, options.max_error)),
        renderer=name,
    )
    frames = drive.frames if options.frames is None else select_frames(options.frames, sorted(drive.time_s))
    moments = moments_of(drive, frames, times, settings.cameras, settings.lidars, of_sensors)
    sources = None if options.sources is None else select_frames(options.sources, prepared.recorded.frames, "--sources")
    about: dict[str, Any] = {
        "scenario": {"name": prepared.scenario.name, "sha256": scenario_hash(prepared.scenario)},
        "log": {"name": drive.name, "world_origin": drive.world_origin.tolist()},
    }
    method = RENDERERS.with_plugins()[name]
    if options.max_error and not method.trained:
        raise UnisimError(f"--max-error {options.max_error[0]}: holds for trained scenes, not for --renderer {name}")
    scene, others = prepared.scene if method.trained else None, prepared.scenes.others(drive)
    method.check_inputs(prepared.log_path, scene)
    recipe = RendererRecipe(
        method, prepared.log_path, scene, others, drive.world_origin, quality, options.device, settings.contact_shadows,
        sources, code_identity()["sha256"], environment(options.device, scenes_of(scene, others)),
    )  # fmt: skip
    digests = method.digests(recipe, drive)
    if scene is not None:
        warnings = capability_warnings(scene, prepared.recorded, drive, bool(settings.lidars))
        about |= {"warnings": warnings} if warnings else {}
    states = method.states(recipe, drive)
    plan = RenderPlan(drive, moments, settings, recipe, digests, dict(recipe.environment), about, states)
    return plan, prepared


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
