"""The stack of `examples/perception` on a log's recorded sensors, beside the same replayed, and shifted to the side.

python -m benchmarks.autonomy LOG WEIGHTS --out FOLDER [--renderer NAME | --scene SCENE] [--shift 2]

Of a procedural street the exact sensors are looked at, too, where the vehicle was recorded and where it is shifted: shifted
sensors are compared with these. Of another log nobody knows what shifted sensors would have seen. FOLDER gets the documents that
`unisim metrics` reads, and the metrics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from examples.perception.sensing import Detectors
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.evaluation.autonomy.document import ModelOutputs, write_outputs
from unisim_blender.core.files import write_file
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.json_file import json_bytes
from unisim_blender.core.prepare.scenario import scenario_at
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.prepare.selection import split_names
from unisim_blender.core.render.captures import states_of
from unisim_blender.core.scenario.edits import Ego
from unisim_blender.core.scenario.simulation import SimulationSpec
from unisim_blender.core.simulation.clock import Exposure
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.sensors import SensorSource, SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import Simulation, open_scenario
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Camera, Lidar
from unisim_street.exact_street import renderer_of_street
from unisim_street.street import RECIPE_FILE, Street, load_street

from .comparison import beside_others, beside_truth, lines
from .outputs import labels_of, outputs_of
from .sensors import RecordedSensors


@dataclass(frozen=True)
class Row:
    """Sensors of a simulation, and the row that they are compared with, if any."""

    simulation: Simulation
    sensors: SensorSource
    reference: str | None = None


def simulated(log: Path, options: RenderOptions, left_m: float, out: Path) -> Simulation:
    """Return the log as it was recorded, or with the vehicle further left. Sensors capture when they were recorded."""
    scenario = scenario_at(log)
    edits = (Ego(shift_left_m=left_m),) if left_m else ()
    opened = open_scenario(replace(scenario, edits=edits), options)
    found = opened.simulation(SimulationSpec(), driver_named("log"), out)
    drive, context = found.context.drive, found.context
    sensors: list[Camera | Lidar] = [*drive.cameras.values(), *drive.lidars.values()]
    recorded = open_log(log)
    there = {name: recorded.image_frames(name) for name in drive.cameras}
    there |= {name: recorded.sweep_frames(name) for name in drive.lidars}
    captures = [Exposure.of(one, Capture.of_frame(one, frame)) for one in sensors for frame in there[one.sensor_id]]
    within = [one for one in captures if context.start_us <= one.start_us and one.end_us <= context.stop_us]
    exposures = tuple(sorted(within, key=lambda one: (one.end_us, one.capture.sensor_id)))
    return replace(found, context=replace(context, exposures=exposures))


def rows_of(log: Path, options: RenderOptions, shift_m: float, out: Path) -> dict[str, Row]:
    """Return the rows of the tables by their names, each behind the one that it is compared with."""
    there, aside = simulated(log, options, 0.0, out), simulated(log, options, shift_m, out)
    street = load_street(log) if (log / RECIPE_FILE).is_file() else None
    shifted = f"shifted {shift_m:g} m"
    rows = {
        "recorded": Row(there, RecordedSensors(open_log(log))),
        "replayed": Row(there, SimulatedSensors(there.plan, there.renderer, None), "recorded"),
    }
    if street is not None:
        rows["exact"] = Row(there, exact(street, there), "recorded")
        rows[f"{shifted}, exact"] = Row(aside, exact(street, aside))
    reference = None if street is None else f"{shifted}, exact"
    rows[shifted] = Row(aside, SimulatedSensors(aside.plan, aside.renderer, None), reference)
    return rows


def exact(street: Street, simulation: Simulation) -> SimulatedSensors:
    """Return a street's exact sensors."""
    drive = simulation.plan.drive
    renderer = renderer_of_street(street, drive.world_origin, simulation.plan.settings.quality)
    plan = replace(simulation.plan, captures=states_of(renderer, drive))
    return SimulatedSensors(plan, renderer, None)


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.argument("log", type=click.Path(path_type=Path))
@click.argument("weights", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for documents and metrics.")
@click.option("--renderer", help="As of `unisim render`.  [default: surfel, or the scene's]")
@click.option("--scene", type=click.Path(path_type=Path), help="A trained scene that replays the log.")
@click.option("--quality", default="balanced", show_default=True)
@click.option("--width", type=int, help="Of rendered images.  [default: the cameras' own]")
@click.option("--sensors", metavar="A,B", help="Cameras and LiDARs by name.  [default: all]")
@click.option("--shift", "shift_m", default=2.0, show_default=True, help="Metres to the left.")
def main(
    log: Path, weights: Path, out: Path, renderer: str | None, scene: Path | None, quality: str, width: int | None,
    sensors: str | None, shift_m: float,
) -> None:  # fmt: skip
    """The stack of WEIGHTS on LOG as recorded, as replayed and shifted."""
    names = None if sensors is None else split_names(sensors)
    options = RenderOptions(renderer=renderer, scene=scene, quality=quality, width=width, sensors=names)
    detectors, recorded = Detectors.load(weights), open_log(log)
    out.mkdir(parents=True, exist_ok=True)
    found: dict[str, ModelOutputs] = {}
    metrics: dict[str, Any] = {}
    for name, row in rows_of(log, options, shift_m, out).items():
        found[name] = outputs_of(row.simulation, row.sensors, detectors)
        labels = labels_of(row.simulation, recorded, found[name])
        write_outputs(out / f"{_file(name)}.json", found[name])
        write_outputs(out / f"{_file(name)}-labels.json", labels)
        metrics[name] = {"truth": beside_truth(found[name], labels)}
        if row.reference is not None:
            others = beside_others(found[name], found[row.reference], labels)
            metrics[name] |= {"reference": row.reference, "others": others}
        click.echo(f"{name}: {len(found[name].frames)} frames", err=True)
    write_file(out / "metrics.json", json_bytes(metrics))
    click.echo("\n".join(lines(metrics)))


def _file(name: str) -> str:
    return name.replace(", ", "-").replace(" ", "-")


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.autonomy")
    except UnisimError as error:
        raise SystemExit(f"Error: {error}") from error
