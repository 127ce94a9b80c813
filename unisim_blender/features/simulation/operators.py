"""A driver in the closed loop of the scene's scenario, in the background; and on from where a rollout is at."""

from __future__ import annotations

import json
import math
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...bridge.objects.simulation import rollout_folder
from ...bridge.objects.source import source_of
from ...bridge.sampling.output_sensors import output_sensors
from ...bridge.sampling.stepping import frame_of
from ...bridge.window.polling import Need, allowed, drive, idle
from ...core.errors import UnisimError
from ...core.files import write_file
from ...core.scenario.times.ranges import recording_us
from ...core.scenario.types import Outputs, Scenario
from ...core.world.captures import SECOND_US
from ...core.world.drive import Drive
from ...editing.reading.writing import write_scenario
from ...editing.sampled.clock import Clock
from ...editing.simulation import stated
from ...editing.simulation.drivers import is_remote
from ...editing.simulation.folders import folder_for, options_of, options_path, scenario_path
from ...editing.simulation.renderers import renderer_options
from ...editing.simulation.rollouts import read_rollout
from ...preferences import device, interpreter
from ...process.background import launch, running
from ...translations import message
from ..drive.export_operators import ReadsScenes
from ..in_steps import AtOnce, in_thread
from ..output.operators import MIN_WIDTH
from .properties import driver_of
from .task import RolloutTask

HERE_S = 0.011
"""A simulation needs a step of at least 10 ms before the end."""


def rollouts_folder(scene: bpy.types.Scene) -> Path | None:
    """Return the folder that a scene's rollouts are written to; None while it is not known."""
    out = scene.unisim_simulation.out
    if not out or (out.startswith("//") and not bpy.data.filepath):
        return None
    return Path(bpy.path.abspath(out)).absolute()


def folder_known(context: bpy.types.Context) -> Need:
    """The folder of rollouts is known."""
    return rollouts_folder(
        context.scene
    ) is not None, "Save the .blend first, or choose a folder for rollouts that does not depend on it"


def driver_named(context: bpy.types.Context) -> Need:
    """The driver is known by its name."""
    return driver_of(context.scene), "Name the driver first: module:function, or its address"


class Simulates(AtOnce, ReadsScenes):
    """What operators share that simulate."""

    def start_of(self, scene: bpy.types.Scene) -> float | None:
        """Return up to when a rollout's scene is as driven; None for any other scene, and for one simulated from its start."""
        text, begin = scene.unisim_simulation.document, scene.unisim_simulation.span_s[0]
        if rollout_folder(scene) is None or not stated.states(text, "start_s"):
            return None
        start_s = stated.stated_number(text, "start_s")
        return start_s if start_s > begin + 1e-6 else None

    def work(self: Any, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Write the scenario beside the rollout's folder and start the command line on it."""
        scene = context.scene
        parent, source, about = rollouts_folder(scene), source_of(scene), scene.unisim_simulation
        assert parent is not None  # the button is grey without
        sensors = output_sensors(scene, context.selected_objects, source.drive)
        driver, chosen_device, renderer, width = driver_of(scene), device(), about.renderer, scene.unisim.sequence_width
        command = ["--driver", driver, "--device", chosen_device]
        command += ["--driver-address", about.address.strip()] if is_remote(driver) else []
        command += ["--sensors", ",".join(sensors)] if sensors is not None else []
        command += renderer_options(renderer)
        command += ["--width", str(max(MIN_WIDTH, width))] if width else []
        read = yield from self.scenario(scene, parent / "scenario.json", self.start_of(scene))
        scenario, scene_name = simulated(read), scene.name
        total = steps_of(scenario, source.drive)
        folder = yield from in_thread(lambda: written(scenario, command, parent, scene_name, driver))
        arguments = ["drive", str(scenario_path(folder)), "--out", str(folder), "--resume", *command]
        task = RolloutTask(arguments, folder, float(total), interpreter())
        about.scored = str(folder)
        launch(task)
        if bpy.app.background and task.problem:
            raise UnisimError(task.problem)


def written(scenario: Scenario, command: list[str], parent: Path, variant: str, driver: str) -> Path:
    """Write a scenario and a command's options beside the folder of their rollout, and return that. Raises `UnisimError`."""
    options = options_of(scenario, command)
    folder = folder_for(parent, variant, driver, options)
    parent.mkdir(parents=True, exist_ok=True)
    write_scenario(replace(scenario, path=scenario_path(folder)), scenario_path(folder))
    write_file(options_path(folder), json.dumps(options, indent=1).encode())
    return folder


def simulated(read: Scenario) -> Scenario:
    """Return a scenario as it is simulated: not at the frames or times that a sequence of it has, with the passes that
    drivers and scores need."""
    outputs = replace(read.outputs or Outputs(), passes=None)
    return replace(read, frames=None, times=None, outputs=outputs)


def steps_of(scenario: Scenario, recorded: Drive) -> int:
    """Return how many steps a scenario's simulation has, at least one. Whether it fits into the drive `unisim drive` says."""
    first_us, last_us = recording_us(recorded)
    spec = scenario.simulation
    start = first_us / SECOND_US if spec is None or spec.start_s is None else spec.start_s
    length = last_us / SECOND_US - start if spec is None or spec.duration_s is None else spec.duration_s
    step = stated.STEP_S if spec is None or spec.step_s is None else spec.step_s
    return max(1, math.ceil(round(length / step, 6)))


class UNISIM_OT_simulate(Simulates, bpy.types.Operator):
    """Let the driver drive through the scenario, with sensors that answer and actors that react, in the background"""

    bl_idname = "unisim.simulate"
    bl_label = "Simulate"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there, the driver and the folder be known, and nothing else be running."""
        return allowed(cls, drive(context), driver_named(context), folder_known(context), idle(running))


def is_rollout(context: bpy.types.Context) -> Need:
    """The scene was opened from a rollout."""
    return context.scene.unisim_simulation.rollout, "Open a rollout first: this scene is none"


def time_now(context: bpy.types.Context) -> float:
    """Return the log's time at the current frame, in seconds."""
    scene = context.scene
    return float(Clock.of(source_of(scene).drive).time_s(np.array(frame_of(scene))))


def within(context: bpy.types.Context) -> Need:
    """The current frame lies in the rollout, before its end."""
    scene = context.scene
    there = False
    if scene.unisim_simulation.rollout and scene.unisim.log:
        begin, end = scene.unisim_simulation.span_s
        try:
            there = begin + 1e-4 < time_now(context) < end - HERE_S
        except (UnisimError, OSError):
            there = False
    return there, "Go to a frame after the start of the rollout and before its end"


class UNISIM_OT_drive_on(Simulates, bpy.types.Operator):
    """Simulate on from the current frame: as driven until then, with the edits of this scene from then on"""

    bl_idname = "unisim.drive_on"
    bl_label = "Drive On from Here"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """As simulating, in a rollout's scene, at a time of the rollout."""
        return allowed(
            cls,
            drive(context),
            is_rollout(context),
            within(context),
            driver_named(context),
            folder_known(context),
            idle(running),
        )

    def work(self, context: bpy.types.Context) -> Generator[str | None, None, None]:
        """Let the simulation start at the rollout's step next to the current frame and end where it ended, and begin it."""
        scene = context.scene
        about, folder, now_s = scene.unisim_simulation, rollout_folder(scene), time_now(context)
        assert folder is not None  # the button is grey without
        rollout = yield from in_thread(lambda: read_rollout(folder))
        about.document = stated.from_time(about.document, rollout.nearest_step(now_s), float(rollout.times_s[-1]))
        bpy.ops.ed.undo_push(message=message("Drive On from Here"))
        yield from super().work(context)


CLASSES = (UNISIM_OT_simulate, UNISIM_OT_drive_on)
