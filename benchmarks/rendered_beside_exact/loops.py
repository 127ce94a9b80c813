"""A loop of a seed, with rendered or with exact sensors, or with noise on these. The world is the street's own in all: start,
actors, ground."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from examples.perception.driver import Perception
from examples.perception.sensing import Detectors
from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import write_file
from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.geometry import invert_pose
from unisim_blender.core.json_file import json_bytes, read_json
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.processes import single_threaded
from unisim_blender.core.render.captures import states_of
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenario.simulation import OTHER_ACTORS, Jitter, RateSpec, SimulationSpec
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.sensors.lidar import column_azimuths, column_times
from unisim_blender.core.simulation.drivers.driver import DriverKind
from unisim_blender.core.simulation.rollout.loop import Rollout, roll_out
from unisim_blender.core.simulation.rollout.score import scores_of
from unisim_blender.core.simulation.rollout.sensors import SensorSource, SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import OpenedScenario, open_scenario
from unisim_blender.core.world.drive import Drive

from .noise import NoisySensors
from .streets import CAMERA, PERIOD_S, log_folder, scene_folder

RENDERED, EXACT = "rendered", "exact"
LEAD = "car-01"
"""Drives before the ego vehicle on every street."""
START_S, DURATION_S = 0.8, 8.0
JITTER = Jitter(ego_along_m=2.0, ego_aside_m=0.3, ego_yaw_deg=1.0, ego_speed_m_s=1.0, actors_s=0.7)
"""Actors are moved in time by less than `START_S`: all are there at the start."""
BRAKES_AFTER_S, DECELERATION_M_S2, SLOWER_M_S = (0.5, 3.0), (2.0, 5.0), (2.0, 5.0)
AHEAD_RAD = np.radians(100.0)
LEADS = "as recorded", "stops", "slows"


@dataclass(frozen=True)
class Unit:
    """A street, a seed of starts and actors, and whose ``sensors`` the driver has: `RENDERED` or `EXACT`. With ``noise_m`` their
    ranges have so much noise; of one deviation there are several draws."""

    street: int
    seed: int
    sensors: str
    noise_m: float = 0.0
    draw: int = 0

    @property
    def name(self) -> str:
        """The sensors in words."""
        return f"{self.sensors}, {self.noise_m:g} m of noise, draw {self.draw}" if self.noise_m else self.sensors

    def path(self, out: Path) -> Path:
        """Return where its result is kept."""
        name = f"{self.sensors}-{self.noise_m:g}m-{self.draw}" if self.noise_m else self.sensors
        return out / f"street-{self.street}" / f"seed-{self.seed}-{name}.json"


@dataclass(frozen=True)
class Loops:
    """Runs units with the detectors in ``weights`` on the streets in ``work``. It pickles."""

    work: Path
    weights: Path
    out: Path
    quality: str
    duration_s: float = DURATION_S

    def settings(self) -> dict[str, Any]:
        """Return what a result depends on besides its unit."""
        return {"quality": self.quality, "start_s": START_S, "duration_s": self.duration_s, "jitter": asdict(JITTER)}

    def __call__(self) -> Callable[[Unit], tuple[Unit, dict[str, Any]]]:
        """Return the function that runs a unit and keeps its result; a street stays open until another one's turn."""
        with single_threaded():
            detectors = Detectors.load(self.weights)
        kept: dict[tuple[int, str], tuple[OpenedScenario, Renderer]] = {}

        def run(unit: Unit) -> tuple[Unit, dict[str, Any]]:
            with single_threaded():
                key = unit.street, unit.sensors
                if key not in kept:
                    kept.clear()
                    kept[key] = self.opened(*key)
                found = self.loop(unit, *kept[key], detectors)
            write_file(unit.path(self.out), json_bytes(found))
            return unit, found

        return run

    def opened(self, street: int, sensors: str) -> tuple[OpenedScenario, Renderer]:
        """Open a street for simulations, and what renders its sensors: the street, or its trained scene."""
        opened = open_scenario(log_folder(self.work, street), RenderOptions(renderer="street", quality=self.quality))
        opened = replace(opened, recorded=looking_ahead(opened.recorded), edited=looking_ahead(opened.edited))
        if sensors == EXACT:
            return opened, opened.renderer
        scene = open_scene(scene_folder(self.work, street))
        return opened, Renderer(load_backend(scene, {}, self.quality))

    def loop(self, unit: Unit, opened: OpenedScenario, renderer: Renderer, detectors: Detectors) -> dict[str, Any]:
        """Return a unit's settings, trajectory and scores."""
        lead, model = lead_of(unit.seed)
        spec = SimulationSpec(
            start_s=START_S, duration_s=self.duration_s, step_s=PERIOD_S, seed=unit.seed, jitter=JITTER,
            actors={OTHER_ACTORS: {"type": "lane"}, LEAD: model},
            rates={name: RateSpec(PERIOD_S) for name in (CAMERA, PANDAR64)},
        )  # fmt: skip
        kind = DriverKind("perception", "", lambda setup: Perception(setup, detectors))
        with tempfile.TemporaryDirectory() as folder:
            simulation = opened.simulation(spec, kind, Path(folder))
            plan = replace(simulation.plan, captures=states_of(renderer, simulation.plan.drive))
            sensors: SensorSource = SimulatedSensors(plan, renderer, None)
            if unit.noise_m:
                sensors = NoisySensors(sensors, unit.noise_m, (unit.street, unit.seed, unit.draw))
            begun = time.process_time()
            rollout = roll_out(simulation, sensors=sensors)
            seconds = time.process_time() - begun
            found = loop_of(rollout, scores_of(simulation, rollout))
        return {**asdict(unit), "lead": lead, "settings": self.settings(), **found, "processor_s": seconds}

    def kept(self, unit: Unit) -> dict[str, Any] | None:
        """Return the result of an earlier run. Raises `OutputError` where it had other settings."""
        path = unit.path(self.out)
        if not path.is_file():
            return None
        found: dict[str, Any] = read_json(path, OutputError)
        if found["settings"] != self.settings():
            raise OutputError(
                f"{path}: was run with {found['settings']}, not with {self.settings()}: name another folder"
            )
        return found


def looking_ahead(drive: Drive) -> Drive:
    """Return the drive with a LiDAR that lacks the columns behind the vehicle, where the detectors do not look: half the cost."""
    lidar, time_s = drive.lidars[PANDAR64], drive.time_s[drive.frames[0]]
    ego_from_lidar = invert_pose(drive.world_from_ego.at(time_s)) @ lidar.world_from_lidar.at(time_s)
    model, azimuths = lidar.model, column_azimuths(lidar.model)
    ahead = ego_from_lidar[0, 0] * np.cos(azimuths) + ego_from_lidar[0, 1] * np.sin(azimuths)
    kept = np.flatnonzero(ahead >= np.cos(AHEAD_RAD))
    times = column_times(lidar, 0.0)[kept] - model.time_offset_s
    model = replace(model, columns=len(kept), column_azimuth_rad=azimuths[kept], column_time_s=times)
    return replace(drive, lidars={PANDAR64: replace(lidar, model=model)})


def lead_of(seed: int) -> tuple[str, dict[str, Any]]:
    """Return what the vehicle ahead does in the loops of a seed, in words and as a model of an actor."""
    rng = np.random.default_rng([seed, 28])
    kind = LEADS[seed % len(LEADS)]
    begins, deceleration, slower = (
        float(rng.uniform(*span)) for span in (BRAKES_AFTER_S, DECELERATION_M_S2, SLOWER_M_S)
    )
    if kind == LEADS[0]:
        return kind, {"type": "lane"}
    first, last = START_S + begins, 0.0 if kind == "stops" else slower
    usual = 8.0
    keys = [(first, usual), (first + (usual - last) / deceleration, last)]
    return kind, {"type": "scripted", "keys": [{"time_s": round(t, 3), "speed_m_s": round(v, 3)} for t, v in keys]}


def loop_of(rollout: Rollout, scores: dict[str, Any]) -> dict[str, Any]:
    """Return where the vehicle was at each step, and the scores that are compared."""
    egos = [step.ego for step in rollout.steps]
    return {
        "time_s": [step.time_us / 1e6 for step in rollout.steps],
        **{name: [round(getattr(ego, name), 4) for ego in egos] for name in ("x_m", "y_m", "speed_m_s")},
        "scores": {
            "collisions": scores["collision"]["count"],
            "collisions_at_fault": scores["collision"]["at_fault_count"],
            "pdms": scores["pdms"]["score"],
            "hd_score": scores["hd_score"]["score"],
            "minimum_ttc_s": scores["time_to_collision"]["minimum_s"],
            "progress": scores["progress"]["share"],
            "driven_m": scores["progress"]["distance_m"],
            "unsupported": scores["unsupported"]["mean_share"],
        },
    }
