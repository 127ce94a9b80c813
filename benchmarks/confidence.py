"""Fit and test the weights of confidence, on procedural streets, whose shifted views are known exactly.

    python benchmarks/confidence.py sample/scene out/scene0 out/scene1 out/scene2 out/scene3 out/scene8

Each scene is rendered beside the truth of its street, moved aside. It prints what the weights fitted to the other scenes say
of each, and at last those of all, which `unisim_blender/core/render/confidence.py` states. The scenes beside the sample, of
`unisim synth out/streetN --seed N` and `unisim train out/streetN --out out/sceneN`:

    seed 0: --frames 40; --preset small --iterations 400
    seed 1: --frames 20; --preset tiny --iterations 250 --rays 1024
    seed 2: --frames 20; --preset small --iterations 350 --rays 1024
    seed 3: --frames 40 --people 5; --preset small --iterations 800 --rays 4096
    seed 8: --frames 40 --people 7 --speed 2.5; --preset small --iterations 550 --rays 2048
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import BoolArray, FloatArray
from unisim_blender.core.model.scene_file import write_scene_header
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.render import confidence
from unisim_blender.core.render.captures import CaptureStates, states_of
from unisim_blender.core.render.confidence import RIGHT_RGB, TOLERANCE, TOLERANCE_M
from unisim_blender.core.render.observed_space import Observing
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.training.export import accuracy
from unisim_blender.core.world.replay import DriveStates
from unisim_street.exact_street import WHOLE, StreetRenderer, renderer_of_street
from unisim_street.street import load_street, street_of

COLUMNS, BEAM_STRIDES = 240, (slice(None, None, 2), slice(None, None, 12))
"""Width of images, and strides through a sweep's beams and columns."""
INSIDE_M, INSIDE_SHARE = 1.6, 0.15
"""Views of which so much is nearer than this are inside of something, and left out."""
FAR_TRUTH_M, FAR_SEEN_M = 150.0, 100.0
"""Beyond the first distance a pixel has the right one where it is beyond the second."""
PRIOR, NEWTON_STEPS, BINS = 1e-3, 40, 10
Samples = dict[str, NDArray[np.float32]]
"""Of one kind of sensor: features (N, F), whether each pixel or beam is right (N,), and the shift (N,), metres."""


class ShiftedViews(NamedTuple):
    """A scene's renderer and that of its street, and the states of a shifted drive in both."""

    renderer: Renderer
    states: CaptureStates
    true: StreetRenderer
    true_states: CaptureStates

    def samples(self, sensor_id: str, frame: int) -> tuple[NDArray[np.float32], BoolArray]:
        """Return the features (N, F) of an image's pixels or a sweep's beams, and which are right; none inside of things."""
        if sensor_id in self.states.drive.cameras:
            camera = self.states.camera(sensor_id, COLUMNS)
            time_s, state = camera.time_s[frame], self.states.state(camera, camera.time_s[frame])
            image = self.renderer.render(state, camera, time_s, ("rgb", "depth", "instance"))
            known = self.true_states.camera(sensor_id, COLUMNS)
            truth = self.true.render(self.true_states.state(known, time_s), known, time_s, ("rgb", "depth"))
            rays, pose = (
                camera_rays(camera, time_s, *pixel_grid(camera.model)).flat(),
                camera.world_from_camera.at(time_s),
            )
            assert image.depth_m is not None and image.instance is not None and truth.depth_m is not None
            depth, instance, true_m = image.depth_m.reshape(-1), image.instance.reshape(-1), truth.depth_m.reshape(-1)
            is_far = (true_m > FAR_TRUTH_M) & (depth > FAR_SEEN_M)
            shown = np.ones(len(depth), bool)
            right = (is_far | _close(depth, true_m)) & (np.abs(image.rgb - truth.rgb) < RIGHT_RGB).all(-1).reshape(-1)
        else:
            lidar = self.states.lidar(sensor_id)
            time_s, state = lidar.time_s[frame], self.states.state(lidar, lidar.time_s[frame])
            every, pose = lidar_rays(lidar, time_s), lidar.world_from_lidar.at(time_s)
            parts = (values[BEAM_STRIDES].copy() for values in (every.origins, every.directions, every.time_s))
            rays = Rays(*parts).flat()
            depth, _, probability, instance = self.renderer.beams(state, rays, lidar)
            true_state, shown = self.true_states.state(self.true_states.lidar(sensor_id), time_s), probability >= 0.5
            true_m = self.true.tracer(true_state).trace(rays, {"depth"}, False, None, RenderStats()).maps["depth"]
            right = _close(depth, true_m)
        if (true_m < INSIDE_M).mean() > INSIDE_SHARE:
            shown = np.zeros_like(right)
        evidence = self.renderer.evidence(
            state, pose, rays, {"depth": depth, "instance": instance}, sensor_id not in self.states.drive.cameras
        )
        assert evidence is not None
        return confidence.features(evidence, depth, instance).T[shown], right[shown]


def _close(depth_m: NDArray[Any], true_m: NDArray[Any]) -> BoolArray:
    with np.errstate(invalid="ignore"):
        close = np.abs(depth_m - true_m) <= np.maximum(TOLERANCE_M, TOLERANCE * true_m)
    return close | (np.isinf(depth_m) & np.isinf(true_m))


def samples_of(path: Path, shifts: Sequence[float], count: int, store: bool) -> dict[str, Samples]:
    """Return samples, by the kind of sensor, of ``count`` frames that a scene was not trained on, at each shift."""
    backend = load_backend(open_scene(path), {}, "balanced", "cpu")
    assert isinstance(backend, Observing)
    renderer, header = Renderer(backend), backend.observed[0]
    log_path, training = (path / header.log_path).resolve(), header.training
    if store or "accuracy" not in training:
        training["accuracy"] = accuracy(renderer.backend, header, open_log(log_path))
        if store:
            write_scene_header(path, header)
    print(f"{path}: right in recorded frames {training['accuracy']}", flush=True)
    street = street_of(load_street(log_path), {})
    held_out = [frame for frame in header.drive.frames if frame not in training["frames"]]
    frames = [held_out[(2 * i + 1) * len(held_out) // (2 * count)] for i in range(count)]
    rows: dict[str, list[tuple[NDArray[np.float32], ...]]] = {"camera": [], "lidar": []}
    for shift in shifts:
        with TemporaryDirectory() as folder:
            file = Path(folder) / "scenario.json"
            document = {"format": "unisim-scenario", "version": 1, "name": "shifted", "log": str(log_path)}
            edits = [{"type": "ego", "shift_left_m": shift}] if shift else []
            file.write_text(json.dumps({**document, "edits": edits}))
            drive = prepare_scenario(file, scene=path).edited
            known = prepare_scenario(file, refined=False).edited
        true = renderer_of_street(street, known.world_origin, "balanced")
        true_states = CaptureStates(DriveStates(known, {}), WHOLE)
        views = ShiftedViews(renderer, states_of(renderer, drive), true, true_states)
        for kind, frame in product(rows, frames):
            for name in training[f"{kind}s"]:
                values, right = views.samples(name, frame)
                rows[kind].append((values, right.astype(np.float32), np.full(len(right), shift, np.float32)))
    names = ("features", "right", "shift")
    return {
        kind: dict(zip(names, (np.concatenate(column) for column in zip(*parts, strict=True)), strict=True))
        for kind, parts in rows.items()
    }


def fitted(scenes: Sequence[Samples]) -> FloatArray:
    """Return the weights (F,), none but the first below 0, that make what is right most probable; every scene counts alike."""
    features = np.concatenate([scene["features"] for scene in scenes]).astype(np.float64)
    right = np.concatenate([scene["right"] for scene in scenes])
    each = np.concatenate([np.full(len(scene["right"]), 1 / len(scene["right"]) / len(scenes)) for scene in scenes])
    used = np.ones(features.shape[1], bool)
    while True:
        weights, x = np.zeros(len(used)), features[:, used]
        part, prior = np.zeros(used.sum()), PRIOR * np.r_[0.0, np.ones(used.sum() - 1)]
        for _ in range(NEWTON_STEPS):
            chance = 1 / (1 + np.exp(-x @ part))
            curvature = (x * (each * chance * (1 - chance))[:, None]).T @ x + np.diag(prior + 1e-9)
            part = part - np.linalg.solve(curvature, x.T @ (each * (chance - right)) + prior * part)
        weights[used] = part
        if weights[1:].min() >= 0:
            return weights
        used[1 + weights[1:].argmin()] = False


def report(weights: FloatArray, samples: Samples) -> str:
    """Return what weights say of a scene beside what is right: mean, area under the curve, calibration error, and for each
    interval of confidence its share, what is said and what is right; then said and right by the shift."""
    right, said = samples["right"], 1 / (1 + np.exp(-samples["features"] @ weights))
    order, wrong = np.argsort(said, kind="stable"), (1 - right).sum()
    ranks = np.empty(len(said))
    ranks[order] = np.arange(len(said))
    area = (ranks[right > 0].sum() - right.sum() * (right.sum() - 1) / 2) / max(right.sum() * wrong, 1)
    interval, rows = np.minimum((said * BINS).astype(int), BINS - 1), []
    for number in np.unique(interval):
        inside = interval == number
        rows.append((inside.mean(), said[inside].mean(), right[inside].mean()))
    error = sum(share * abs(a - b) for share, a, b in rows)
    moved = [(shift, said[samples["shift"] == shift].mean(), right[samples["shift"] == shift].mean())
             for shift in np.unique(samples["shift"])]  # fmt: skip
    return (
        f"right {right.mean():.3f} said {said.mean():.3f} area {area:.3f} calibration error {error:.3f}\n"
        f"    share, said, right: {'; '.join('{:.3f} {:.2f} {:.2f}'.format(*row) for row in rows)}\n"
        f"    shift, said, right: {'; '.join('{:+.0f} {:.2f} {:.2f}'.format(*row) for row in moved)}"
    )


@click.command()
@click.argument("scenes", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--shifts", default="-3,-2,0,2,3", show_default=True, help="Metres to the left.")
@click.option("--frames", default=2, show_default=True, help="Frames of each scene.")
@click.option("--test", multiple=True, type=click.Path(path_type=Path), help="A scene that weights are not fitted to.")
@click.option(
    "--store", is_flag=True, help="Measure how right the scenes' recorded frames are, and write it into them."
)
@click.option("--cache", type=click.Path(path_type=Path), help="Folder of samples, which are rendered once.")
def main(
    scenes: tuple[Path, ...], shifts: str, frames: int, test: tuple[Path, ...], store: bool, cache: Path | None
) -> None:
    """Fit and test the weights of confidence."""
    every: dict[Path, dict[str, Samples]] = {}
    for path in (*scenes, *test):
        file = None if cache is None else cache / f"{path.resolve().name}.npz"
        if file is not None and file.exists():
            with np.load(file) as stored:
                names = [name.split(".") for name in stored.files]
                every[path] = {kind: {n: stored[f"{kind}.{n}"] for k, n in names if k == kind} for kind, _ in names}
            continue
        every[path] = samples_of(path, [float(shift) for shift in shifts.split(",")], frames, store)
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            np.savez(
                file, **{f"{k}.{n}": values for k, of_kind in every[path].items() for n, values in of_kind.items()}
            )
    for kind in ("camera", "lidar"):
        for path in every:
            others = [every[other][kind] for other in scenes if other != path]
            if others:
                print(f"{kind} {path.name}, held out: {report(fitted(others), every[path][kind])}")
        weights = fitted([every[path][kind] for path in scenes])
        for path in scenes:
            print(f"{kind} {path.name}, fitted: {report(weights, every[path][kind])}")
        print(f"{kind.upper()}_WEIGHTS = ({', '.join(f'{weight:.3f}' for weight in weights)})")


if __name__ == "__main__":
    main()
