"""The benchmark's commands."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.evaluation.autonomy.document import write_outputs
from unisim_blender.core.evaluation.autonomy.measure import measure
from unisim_blender.core.files import write_file
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.output.frame_files import png_bytes
from unisim_blender.core.prepare.selection import select_frames

from .samples import Key, Sample, read_set, sample_from_log, settings, write_set
from .streets import StreetSet

if TYPE_CHECKING:
    from .training import Trained


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
def main() -> None:
    """Vehicle detectors of LiDAR sweeps and camera images, trained and tested on exact, recorded and
    simulated frames."""


def street_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options that say which streets and frames, as an argument ``streets``."""

    @wraps(command)
    def with_streets(
        *args: Any, seeds: str, length: int, step: int, varied: bool, left: float, size: str, **options: Any
    ) -> None:
        start, stop = _two_numbers(seeds, ":", "--seeds")
        streets = StreetSet(tuple(range(start, stop)), length, step, varied, left, *_two_numbers(size, "x", "--size"))
        command(*args, streets=streets, **options)

    for option in (
        click.option(
            "--size",
            default="320x180",
            show_default=True,
            metavar="WxH",
            help="Pixels of the images that are rendered.",
        ),
        click.option(
            "--left", default=0.0, show_default=True, help="Metres that the vehicle drives further to the left."
        ),
        click.option(
            "--varied/--recorded", default=True, show_default=True, help="Traffic and vehicle elsewhere than recorded."
        ),
        click.option("--step", default=8, show_default=True, help="Every how many frames there is a sample."),
        click.option("--length", default=40, show_default=True, help="Frames of each street's drive."),
        click.option("--seeds", default="100:124", show_default=True, metavar="START:STOP", help="Which streets."),
    ):
        with_streets = option(with_streets)
    return with_streets


@main.command()
@click.argument("out", type=click.Path(path_type=Path))
@street_options
def street(out: Path, streets: StreetSet) -> None:
    """A set of exact streets in the folder OUT; what is there already is kept."""
    write_set(out, {"streets": settings(streets)}, streets.keys, streets.sample)


@main.command()
@click.argument("out", type=click.Path(path_type=Path))
@street_options
@click.option(
    "--scenes", required=True, type=click.Path(path_type=Path), help="Folder for the streets' logs and trained scenes."
)
@click.option("--steps", default=900, show_default=True, help="Of each scene's training.")
@click.option("--preset", default="compact", show_default=True, help="Size of the scenes.")
def simulated(out: Path, streets: StreetSet, scenes: Path, steps: int, preset: str) -> None:
    """The same set in the folder OUT as scenes simulate it that are trained on the streets as recorded, on
    all other frames."""
    from .simulated import SimulatedSet

    about = {"streets": settings(streets), "steps": steps, "preset": preset}
    write_set(out, about, streets.keys, SimulatedSet(streets, scenes, steps, preset).sample)


@main.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--frames", metavar="START:STOP:STEP", help="Frames by number. [default: all]")
@click.option("--camera", default="front_camera", show_default=True)
@click.option("--lidar", default="pandar64", show_default=True)
def log(log: Path, out: Path, frames: str | None, camera: str, lidar: str) -> None:
    """A set of a log with labels in the folder OUT: a recorded one, or one that `unisim render --format pandaset`
    wrote."""
    recorded = open_log(log)
    both = sorted(set(recorded.image_frames(camera)) & set(recorded.sweep_frames(lidar)))
    chosen = both if frames is None else [frame for frame in select_frames(frames, both) if frame in both]
    about = {"log": recorded.drive.name, "camera": camera, "lidar": lidar, "frames": chosen}
    keys = [Key(recorded.drive.name, frame) for frame in chosen]
    write_set(out, about, keys, lambda key: sample_from_log(recorded, camera, lidar, key.frame))


@main.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--frames", metavar="START:STOP:STEP", help="Frames by number. [default: all]")
def truth(scenario: Path, out: Path, frames: str | None) -> None:
    """A set of what a SCENARIO on a street truly shows, in the folder OUT, by whoever draws that street's images."""
    from .truth import TrueSet

    true = TrueSet(scenario, frames)
    write_set(out, true.about, true.keys, true.sample)


@main.command()
@click.argument("detector", type=click.Choice(["lidar", "camera"]))
@click.argument("sets", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Folder of the detector; a training there goes on."
)
@click.option("--steps", default=600, show_default=True)
@click.option("--batch", default=6, show_default=True, help="Samples a step.")
@click.option("--seed", default=0, show_default=True)
@click.option("--threads", default=1, show_default=True)
def train(detector: str, sets: tuple[Path, ...], out: Path, steps: int, batch: int, seed: int, threads: int) -> None:
    """Train a detector on all samples of SETS."""
    import torch

    from . import training

    torch.set_num_threads(threads)
    training.train(detector, sets, out, steps, batch, seed)


@main.command()
@click.argument("detector", type=click.Path(path_type=Path))
@click.argument("set_", metavar="SET", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for documents, metrics and images.")
@click.option("--images", default=6, show_default=True, help="Frames to draw, spread over the set.")
@click.option("--least", default=0.3, show_default=True, help="Least score of the detections that are drawn.")
def test(detector: Path, set_: Path, out: Path, images: int, least: float) -> None:
    """AP of a trained DETECTOR on SET, its detections and labels as `unisim metrics` reads them, and images."""
    import numpy as np

    from .images import image
    from .testing import detect, labels, markdown, without_scores_below
    from .training import load_detector

    trained, samples = load_detector(detector), read_set(set_)
    _tell_of_overlap(trained, samples)
    found, truth = detect(trained, samples), labels(trained.detector, samples)
    metrics = measure(found, truth)
    out.mkdir(parents=True, exist_ok=True)
    write_outputs(out / "detections.json", found)
    write_outputs(out / "labels.json", truth)
    write_file(out / "metrics.json", (json.dumps(metrics, indent=1) + "\n").encode())
    shown = without_scores_below(found, least)
    keys = list(samples)
    for index in np.unique(np.linspace(0, len(keys) - 1, min(images, len(keys))).round().astype(int)):
        key = keys[index]
        place = (key.sequence, key.frame)
        drawn = image(trained.detector.kind, samples[key], truth.frames[place], shown.frames[place])
        write_file(out / f"{key.name}.png", png_bytes(drawn))
    for line in markdown({f"{trained.detector.name}, {set_.name}": metrics["classes"]["vehicle"]}):
        click.echo(line)


@main.command()
@click.argument("detector", type=click.Path(path_type=Path))
@click.argument("real", type=click.Path(path_type=Path))
@click.argument("simulated", type=click.Path(path_type=Path))
@click.option(
    "--sim-trained", type=click.Path(path_type=Path), help="A detector trained on simulated frames, for Sim2Real."
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="File for all metrics, as JSON.")
def gap(detector: Path, real: Path, simulated: Path, sim_trained: Path | None, out: Path) -> None:
    """Real2Sim, Sim2Real and agreement: a DETECTOR trained on real frames, and the same frames in sets
    REAL and SIMULATED."""
    from .testing import gaps, markdown
    from .training import load_detector

    trained, other = load_detector(detector), None if sim_trained is None else load_detector(sim_trained)
    frames = read_set(real)
    for one in (trained, other):
        _tell_of_overlap(one, frames)
    metrics = gaps(trained, other, frames, read_set(simulated))
    write_file(out, (json.dumps(metrics, indent=1) + "\n").encode())
    names = [name for name in ("real", "real2sim", "sim2real") if name in metrics]
    rows = {name: metrics[name] for name in names} | {f"lost, {name}": value for name, value in metrics["lost"].items()}
    for line in [*markdown(rows), "", *markdown({"agreement": metrics["agreement"]})]:
        click.echo(line)


@main.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@click.argument("detectors", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for recall.json and recall.png.")
@click.option("--visibilities", default="20,35,50,75,100,200,400", show_default=True, metavar="M,M,…")
@click.option("--frames", metavar="START:STOP:STEP", help="Frames by number. [default: the scenario's]")
@click.option("--camera", default="front_camera", show_default=True)
@click.option("--lidar", default="pandar64", show_default=True)
def weather(
    scenario: Path,
    detectors: tuple[Path, ...],
    out: Path,
    visibilities: str,
    frames: str | None,
    camera: str,
    lidar: str,
) -> None:
    """Recall of trained DETECTORS over visibility, on frames of a SCENARIO that are rendered in fog."""
    from .training import load_detector
    from .weather import foggy_samples, plot, recalls

    try:
        fog = [float(text) for text in visibilities.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"must be numbers with commas between them, not {visibilities!r}") from error
    trained = [load_detector(path) for path in detectors]
    samples = foggy_samples(scenario, frames, camera, lidar, [None, *fog])
    results = {one.detector.name: recalls(one, samples) for one in trained}
    out.mkdir(parents=True, exist_ok=True)
    write_file(out / "recall.json", (json.dumps(results, indent=1) + "\n").encode())
    plot(results, out / "recall.png")
    for name, result in results.items():
        for row in result["rows"]:
            where = "clear" if row["visibility_m"] is None else f"{row['visibility_m']:g} m"
            click.echo(f"{name}, {where}: recall {100 * row['recall']:.1f} %")


def _two_numbers(text: str, between: str, option: str) -> tuple[int, int]:
    first, _, second = text.partition(between)
    if not (first.isdecimal() and second.isdecimal()):
        raise click.BadParameter(
            f"must be two whole numbers with {between!r} between them, not {text!r}", param_hint=option
        )
    return int(first), int(second)


def _tell_of_overlap(trained: Trained | None, samples: Mapping[Key, Sample]) -> None:
    from .testing import trained_on

    seen = [] if trained is None else trained_on(trained, samples)
    if trained is not None and seen:
        click.echo(
            f"Note: the {trained.detector.name} detector was trained on {', '.join(seen)}, which it is tested on here",
            err=True,
        )


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.detection")
    except UnisimError as error:
        raise SystemExit(f"Error: {error}") from error
