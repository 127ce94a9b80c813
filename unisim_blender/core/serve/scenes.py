"""The scenes that are served: scenarios, logs and trained scenes, each opened once and kept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import UnisimError
from ..geometry import FloatArray, Trajectory, invert_pose
from ..prepare.scenario_plan import RenderOptions, plan_scenario
from ..render.captures import CaptureStates
from ..render.renderer import Renderer
from ..simulation.vehicle.ground import axle_height
from ..simulation.vehicle.parameters import Vehicle
from ..world.drive import Drive


@dataclass(frozen=True, eq=False)
class ServedScene:
    """A scene under its id.

    ``drive`` has its edits and sensors, ``captures`` what of it each capture depends on; ``draw`` as of
    `captures.render_sweep`; ``world_from_rig`` is the recorded trajectory of AlpaSim's rig, which lies on the
    ground below the middle of the rear axle; ``rig_from_sensor`` (4, 4) by the sensors' names. ``warnings``: a sentence
    for each thing that the renderer cannot show.
    """

    scene_id: str
    drive: Drive
    renderer: Renderer
    captures: CaptureStates
    draw: int | None
    world_from_rig: Trajectory
    rig_from_sensor: Mapping[str, FloatArray]
    warnings: tuple[str, ...] = ()


def open_scenes(paths: Iterable[Path], options: RenderOptions) -> dict[str, ServedScene]:
    """Open scenarios, logs or trained scenes for serving, by their ids, the scenarios' names. Raises `UnisimError`, also where
    two have one name."""
    scenes: dict[str, ServedScene] = {}
    for path in paths:
        scene = open_served_scene(path, options)
        if scene.scene_id in scenes:
            raise UnisimError(f'{path}: there is a scene "{scene.scene_id}" already; give one of them another name')
        scenes[scene.scene_id] = scene
    return scenes


def open_served_scene(path: Path, options: RenderOptions) -> ServedScene:
    """Open one scene; see `open_scenes`."""
    plan, prepared = plan_scenario(path, replace(options, passes=("rgb",)))
    renderer = plan.recipe.load()
    spec = prepared.scenario.simulation
    vehicle = Vehicle.from_dict((spec.vehicle if spec else None) or {}, f"{path}: simulation.vehicle")
    drive = plan.drive
    middle_s = drive.time_s[drive.frames[len(drive.frames) // 2]]
    world_from_ego, ego_from_rig = drive.world_from_ego.at(middle_s), vehicle.ego_from_axle
    heights = renderer.tracer(plan.captures.states.state(middle_s, middle_s)).heights
    ego_from_rig[2, 3] -= axle_height(world_from_ego, vehicle, heights)
    rig_from_world = invert_pose(world_from_ego @ ego_from_rig)
    mounts = {name: rig_from_world @ sensor.trajectory.at(middle_s) for name, sensor in drive.sensors.items()}
    return ServedScene(
        prepared.scenario.name,
        drive,
        renderer,
        plan.captures,
        plan.settings.draw,
        drive.world_from_ego.transformed(right=ego_from_rig),
        mounts,
        tuple(plan.about.get("warnings", ())),
    )
