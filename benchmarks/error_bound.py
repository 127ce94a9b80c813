"""How often `--max-error` keeps its promise, against whole frames at the truth, and what it costs beside the cheapest
of the fixed settings that keep the bound in every frame.

python benchmarks/error_bound.py FILE --scene sample/scene --width 320 --frames 0:20:2 --bound 40dB --bound 1mm \\
    --seeds 2
python benchmarks/error_bound.py FILE

FILE has a line for each frame and sensor, and grows: a frame that it has already is not rendered again. Without a scene
it is summed up. Seconds are of the processor, for one thread.
"""

from __future__ import annotations

import json
import os
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.prepare.selection import select_frames
from unisim_blender.core.render.bounded import BoundedRenderer, at_quality, colour_errors
from unisim_blender.core.render.captures import CaptureStates, render_image, render_sweep, states_of
from unisim_blender.core.render.quality import ERROR_BOUND_QUALITIES, TRUTH_QUALITY
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.sensors.error_bound import ErrorBound, depth_errors, parse_bounds
from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame
from unisim_blender.core.world.captures import Capture

Frame = CameraFrame | LidarFrame
Row = dict[str, Any]


def errors_of(frame: Frame, truth: Frame) -> dict[str, FloatArray]:
    """Every pixel's or beam's errors, by `ErrorBound.unit`."""
    if isinstance(frame, LidarFrame) and isinstance(truth, LidarFrame):
        return {"mm": depth_errors(frame.depth_m, truth.depth_m)}
    assert isinstance(frame, CameraFrame) and isinstance(truth, CameraFrame)
    a, b = (np.clip(x.rgb.reshape(-1, 3), 0, 1).astype(np.float64) for x in (frame, truth))
    return colour_errors(a, b)


def true_error(bound: ErrorBound, errors: dict[str, FloatArray]) -> float:
    """A whole frame's, as `ErrorBound.most` counts."""
    of = errors[bound.unit]
    return float(np.quantile(of, bound.quantile, method="inverted_cdf") if bound.unit == "mm" else of.mean())


class Sensor:
    """A camera or a LiDAR of a scene, rendered in several ways."""

    def __init__(
        self,
        renderer: Renderer,
        states: CaptureStates,
        name: str,
        width: int | None,
        bounds: list[ErrorBound],
        seeds: int,
    ) -> None:
        self.renderer, self.states, self.name, self.width, self.bounds = renderer, states, name, width, bounds
        self.seeds = [BoundedRenderer(renderer, states, bounds, seed=seed) for seed in range(seeds)]

    def render(self, frame: int, bounded: BoundedRenderer | None = None) -> tuple[Frame, float]:
        """A frame, and its seconds."""
        begun = time.process_time()
        out: Frame
        if self.width:
            capture = Capture.of_frame(self.states.camera(self.name), frame)
            if bounded is None:
                out = render_image(self.renderer, self.states, capture, width=self.width)
            else:
                out = bounded.image(capture, width=self.width)
        else:
            capture = Capture.of_frame(self.states.lidar(self.name), frame)
            out = render_sweep(self.renderer, self.states, capture) if bounded is None else bounded.sweep(capture)
        return out, time.process_time() - begun

    def row(self, frame: int) -> Row:
        """All there is to say of one frame."""
        with at_quality(self.renderer, TRUTH_QUALITY):
            truth, _ = self.render(frame)
        fixed, promises = {}, []
        for name, quality in ERROR_BOUND_QUALITIES.items():
            with at_quality(self.renderer, quality):
                found, seconds = self.render(frame)
            errors = errors_of(found, truth)
            fixed[name] = {
                "seconds": seconds,
                "errors": {str(bound): true_error(bound, errors) for bound in self.bounds},
            }
        for bound in self.bounds:
            for bounded in self.seeds:
                bounded.of_depth, bounded.of_colour = ((bound,), ()) if bound.unit == "mm" else ((), (bound,))
                found, seconds = self.render(frame, bounded)
                assert found.error_bound is not None
                check = found.error_bound.checks[0]
                promises.append({
                    "bound": str(bound), "limit": bound.most, "seed": bounded.seed,
                    "settings": found.error_bound.settings,
                    "estimate": check.estimate, "most": check.most, "true": true_error(bound, errors_of(found, truth)),
                    "seconds": seconds,
                })  # fmt: skip
        return {"fixed": fixed, "promises": promises}


def summed_up(rows: list[Row]) -> None:
    """A line for each scene, sensor, width and bound."""
    groups: dict[tuple[str, str, int], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row["scene"], row["sensor"], row["width"]].append(row)
    total = promised = held = 0
    for (scene, sensor, width), group in groups.items():
        for bound in dict.fromkeys(p["bound"] for row in group for p in row["promises"]):
            of = [p for row in group for p in row["promises"] if p["bound"] == bound]
            said = [p for p in of if p["most"] <= p["limit"]]
            true = [p for p in said if p["true"] <= p["limit"]]
            able = [
                n
                for n in ERROR_BOUND_QUALITIES
                if all(row["fixed"][n]["errors"][bound] <= of[0]["limit"] for row in group)
            ]
            seeds = len({p["seed"] for p in of})
            # the first frame's seconds hold what is done once for a camera
            later = [p for p in of if p is not of[0]]
            costs = np.median([p["seconds"] for p in later]) if later else float("nan")
            cheapest = np.median([row["fixed"][able[0]]["seconds"] for row in group]) if able else float("nan")
            settings = {n: sum(p["settings"] == n for p in of) for n in ERROR_BOUND_QUALITIES}
            print(
                f"{scene} {sensor} {width or ''} {bound}: frames x seeds {len(group)} x {seeds}; promised {len(said)}, "
                f"kept {len(true)}; seconds {costs:.2f}, fixed {able[0] if able else 'none'} {cheapest:.2f}: "
                f"{costs / cheapest:.2f} times; settings {', '.join(f'{n}: {k}' for n, k in settings.items() if k)}"
            )
            total, promised, held = total + len(of), promised + len(said), held + len(true)
    print(f"of {total} frames {promised} were promised, {held} of them kept: {100 * held / max(promised, 1):.2f} %")


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--scene", type=click.Path(path_type=Path))
@click.option("--width", type=int, default=320, show_default=True, help="0 for the LiDAR.")
@click.option("--frames", default=None)
@click.option("--bound", "texts", multiple=True)
@click.option("--seeds", default=1, show_default=True)
def main(file: Path, scene: Path | None, width: int, frames: str | None, texts: tuple[str, ...], seeds: int) -> None:
    """Measure some frames into FILE, or sum up what it holds."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    if scene is None:
        summed_up(rows)
        return
    os.environ["OMP_NUM_THREADS"] = "1"
    header = read_scene_header(scene)
    bounds = [bound for bound in parse_bounds(texts) if (bound.unit == "mm") == (width == 0)]
    name = header.training["cameras"][0] if width else next(n for n, x in header.drive.lidars.items() if x.model.beams)
    renderer = Renderer(load_backend(open_scene(scene)))
    sensor = Sensor(renderer, states_of(renderer, header.drive), name, width, bounds, seeds)
    done = {(row["scene"], row["sensor"], row["width"], row["frame"]) for row in rows}
    for frame in select_frames(frames, header.drive.frames):
        about = {"scene": scene.name, "sensor": name, "width": width, "frame": frame}
        if tuple(about.values()) in done:
            continue
        line = json.dumps({**about, **sensor.row(frame)})
        with file.open("a") as out:
            out.write(line + "\n")
        click.echo(f"{scene.name} {name} {frame}")


if __name__ == "__main__":
    main()
