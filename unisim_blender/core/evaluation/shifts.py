"""The shift curve: what detectors recall of labelled actors in views beside the recorded path, by the distance to it.

Off the path a real drive has no ground truth to compare pixels with. What can be counted is whether a detector still sees what is
labelled: by its recall in recorded frames, at the score of its best F1 there. On logs whose truth is known the same curve of the
true shifted views says how much of a loss is the view's.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colour import bytes_from_srgb
from ..data.images import resize_image
from ..data.log import Log
from ..errors import UnisimError
from ..files import holds_out, write_file
from ..formats.readers import drive_in, open_log
from ..geometry import FloatArray, invert_pose, transform_points
from ..json_file import json_bytes
from ..prepare.renderers import SURFEL_METHODS
from ..prepare.replay import aligned_log
from ..prepare.scenario import prepare_scenario
from ..prepare.selection import beam_lidars, check_names, select_frames, spread_frames
from ..registry import named_function
from ..render.captures import render_sweep
from ..render.code_identity import code_identity
from ..scenes.scene import open_scene
from ..sensors.frames import LidarFrame
from ..world.captures import Capture
from ..world.drive import Drive
from .comparison.renderers import untrained_renderer
from .ground_truth import KnownLog, known_log
from .images import CaptionedImage, write_contact_sheet
from .recorded import TimedRenderer
from .recorded_runs import EvaluationOptions, Progress, trained_frames
from .shift_recall import LabelledFrame, Recall, ShiftDetector, label_image, label_sweep, lost_per_metre, returns_of

SHIFTS_M = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
"""To the left."""
FRAMES = 12
RECORDED, TRUTH, OURS = "recorded", "truth", "scene"
OUTLINE = np.array([255, 64, 255], np.uint8)


@dataclass(frozen=True)
class ShiftOptions:
    """``detector``: module:function; ``beside``: renderers without a scene, by name, or folders of other scenes;
    ``count``: number of frames."""

    detector: str
    beside: tuple[str, ...] = ()
    count: int = FRAMES


@dataclass(frozen=True)
class ShiftedSensors:
    """A drive beside the path, and what shows it: images (H, W, 3), sRGB, by camera and frame; returns (N, 4) in the world, with
    intensities, by LiDAR and frame. None where there is none."""

    drive: Drive
    image: Callable[[str, int], NDArray[np.uint8] | None]
    returns: Callable[[str, int], FloatArray | None]


ShiftRow = Mapping[float, Callable[[], ShiftedSensors]]
"""A row of the curve, by shift."""
Key = tuple[str, str, float]
"""Kind of sensor, class, and shift."""


@holds_out
def shift_curve(
    scene: Path, log_path: Path, out: Path, options: EvaluationOptions, shifts: ShiftOptions, progress: Progress
) -> dict[str, Any]:
    """Measure the shift curve of a trained scene and of what is beside it, and write shifts.md, views.png and, where
    matplotlib is there, shifts.png to ``out`` after each row, and shifts.json; the metrics. Raises `UnisimError`."""
    header = open_scene(scene).header
    log = aligned_log(header, open_log(log_path))
    detector: ShiftDetector = named_function("--detector", shifts.detector, "nothing")()
    labels, known_to_it = {actor.label for actor in log.drive.actors.values()}, set().union(*detector.classes.values())
    if not labels & known_to_it:
        raise UnisimError(
            f"{log_path}: its actors are of the classes {', '.join(sorted(labels)) or 'none'}; --detector names "
            f"{', '.join(sorted(known_to_it))}"
        )
    cameras = options.cameras or tuple(header.training.get("cameras", header.drive.cameras))
    check_names("camera", cameras, log.drive.cameras)
    lidars = tuple(name for name in beam_lidars(log) if log.sweep_frames(name))
    trained = trained_frames(header)
    among = [frame for frame in log.drive.frames if frame not in trained] or log.drive.frames
    if options.frames is not None:
        among = select_frames(options.frames, log.drive.frames)
    # what was not recorded has no labels that count, and would count for false alarms
    files = [*map(log.image_frames, cameras), *map(log.sweep_frames, lidars)]
    among = [frame for frame in among if all(frame in recorded for recorded in files)]
    if not among:
        raise UnisimError(f"{log_path}: has no frame of {', '.join((*cameras, *lidars))} to look at that was recorded")
    run = ShiftRun(
        log, detector, cameras, lidars, options.width or header.training.get("width"),
        spread_frames(log.drive, shifts.count, among), {shift: _scenario(out, log_path, shift) for shift in SHIFTS_M},
    )  # fmt: skip
    rows: dict[str, Callable[[], ShiftRow]] = {RECORDED: run.recorded, OURS: partial(run.of_scene, scene, options)}
    for name in shifts.beside:
        if name in SURFEL_METHODS:
            rows[name] = partial(run.of_log, name, trained or None, options)
        else:
            rows[Path(name).name] = partial(run.of_scene, Path(name), options)
    known = known_log(drive_in(log_path))
    if known is not None:
        rows[TRUTH] = partial(run.of_truth, known, trained)
    about = {
        "scene": header.name, "log": log.drive.name, "detector": shifts.detector, "cameras": list(cameras),
        "lidars": list(lidars), "width": run.width, "frames": list(run.frames), "code": code_identity(),
    }  # fmt: skip
    recalls: dict[str, dict[Key, Recall]] = {}
    document: dict[str, Any] = {}
    for name, row in rows.items():
        recalls[name] = run.measure(name, row(), progress)
        document = {**about, **curves(recalls, run.clear)}
        write_file(out / "shifts.md", ("\n".join(tables(document)) + "\n").encode())
        if run.views:
            write_contact_sheet(out / "views.png", list(run.views.values()))
        write_plot(out / "shifts.png", document["curves"])
    write_file(out / "shifts.json", json_bytes(document))  # last: where it is, it is whole
    return document


def _scenario(out: Path, log: Path, shift_m: float) -> Path:
    path = out / "scenarios" / f"shift{shift_m:+g}m.json"
    edits = [{"type": "ego", "shift_left_m": shift_m}] if shift_m else []
    document = {"format": "unisim-scenario", "version": 1, "name": path.stem, "log": str(log.resolve()), "edits": edits}
    write_file(path, (json.dumps(document, indent=1) + "\n").encode())
    return path


@dataclass
class ShiftRun:
    """What rows of a curve have in common. ``clear``: the frames that are looked at, by shift, those in which the vehicle
    stands in no actor; ``views``: the views of the frame in the middle, by row."""

    log: Log
    detector: ShiftDetector
    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    width: int | None
    frames: tuple[int, ...]
    scenarios: Mapping[float, Path]
    views: dict[str, list[CaptionedImage]] = field(default_factory=dict)
    clear: dict[float, tuple[int, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for shift, path in self.scenarios.items():
            drive = prepare_scenario(path, refined=False).edited
            clear = spread_frames(drive, len(drive.frames), drive.frames)
            self.clear[shift] = tuple(frame for frame in self.frames if frame in clear)
        self._returns = {frame: returns_of(self.log, self.lidars, frame) for frame in self.frames}
        if not hasattr(self.detector, "in_image"):
            self.cameras = ()
        if not hasattr(self.detector, "in_sweep"):
            self.lidars = ()

    def recorded(self) -> ShiftRow:
        """Return what was recorded, which is not shifted."""
        drive = self.log.drive

        def image(camera: str, frame: int) -> NDArray[np.uint8] | None:
            if frame not in self.log.image_frames(camera):
                return None
            return resize_image(self.log.image(camera, frame), self._model(drive, camera))

        def returns(lidar: str, frame: int) -> FloatArray | None:
            if frame not in self.log.sweep_frames(lidar):
                return None
            sweep = self.log.sweep(lidar, frame)
            return np.column_stack([sweep.points, sweep.intensity])

        return {0.0: lambda: ShiftedSensors(drive, image, returns)}

    def of_scene(self, scene: Path, options: EvaluationOptions) -> ShiftRow:
        """Return what a trained scene renders."""
        renderer = options.renderer(open_scene(scene), {}, self.log)

        def sensors(path: Path) -> ShiftedSensors:
            drive = prepare_scenario(path, scene=scene).edited
            return self._rendered(TimedRenderer(renderer, drive), drive)

        return self._row(sensors)

    def of_log(self, name: str, frames: tuple[int, ...] | None, options: EvaluationOptions) -> ShiftRow:
        """Return what a renderer without a scene makes of frames of the log."""
        method = untrained_renderer(name, self.log, frames or self.log.drive.frames, options.quality)

        def sensors(path: Path) -> ShiftedSensors:
            drive = prepare_scenario(path, refined=False).edited
            return self._rendered(method.renderer(drive), drive)

        return self._row(sensors)

    def of_truth(self, known: KnownLog, trained: tuple[int, ...]) -> ShiftRow:
        """Return what the sensors would truly see."""

        def sensors(path: Path) -> ShiftedSensors:
            truth = known.truth(prepare_scenario(path, refined=False), trained, self.cameras, self.width)
            truth.draw(path, self.frames, self.cameras)
            return ShiftedSensors(
                truth.drive("edit"),
                lambda camera, frame: bytes_from_srgb(truth.image("edit", camera, frame)),
                lambda lidar, frame: _returns(truth.sweep("edit", lidar, frame)),
            )

        return self._row(sensors)

    def _row(self, sensors: Callable[[Path], ShiftedSensors]) -> ShiftRow:
        return {shift: partial(sensors, path) for shift, path in self.scenarios.items()}

    def _rendered(self, renderer: TimedRenderer, drive: Drive) -> ShiftedSensors:
        def sweep(lidar: str, frame: int) -> FloatArray | None:
            capture = Capture.of_frame(renderer.states.lidar(lidar), frame)
            return _returns(render_sweep(renderer.renderer, renderer.states, capture))

        return ShiftedSensors(
            drive, lambda camera, frame: bytes_from_srgb(renderer.camera(camera, frame, width=self.width).rgb), sweep
        )

    def _model(self, drive: Drive, camera: str) -> Any:
        model = drive.cameras[camera].model
        return model if self.width is None else model.resized(self.width)

    def measure(self, name: str, row: ShiftRow, progress: Progress) -> dict[Key, Recall]:
        """Detect in a row's clear frames; in all frames that were recorded."""
        recalls: dict[Key, Recall] = {}
        made: tuple[float, ShiftedSensors] | None = None
        frames = {0.0: self.frames} if name == RECORDED else self.clear
        jobs = [(shift, frame) for shift in sorted(row) for frame in frames[shift]]
        for index in progress(range(len(jobs)), name):
            shift, frame = jobs[index]
            if made is None or made[0] != shift:
                made = shift, row[shift]()
            self._detect(name, shift, frame, made[1], recalls)
        return recalls

    def _detect(self, name: str, shift: float, frame: int, shown: ShiftedSensors, recalls: dict[Key, Recall]) -> None:
        drive = shown.drive

        def count(kind: str, boxes: str, labels: LabelledFrame, detections: Any, sensor: str) -> None:
            for group, of in self.detector.classes.items():
                recall = recalls.setdefault((kind, group, shift), Recall())
                recall.add((sensor, frame), labels, detections, group, boxes, of)

        for camera in self.cameras:
            rgb = shown.image(camera, frame) if frame in drive.cameras[camera].time_s else None
            if rgb is None:
                continue
            sized = replace(drive.cameras[camera], model=self._model(drive, camera))
            labels, detections = label_image(drive, sized, frame, self._returns[frame]), self.detector.in_image(rgb)
            count("camera", "image", labels, detections, camera)
            if frame == self.frames[len(self.frames) // 2] and camera == self.cameras[0]:
                tile = CaptionedImage(f"{name}, {shift:+g} m", _outlined(rgb, detections[0]))
                self.views.setdefault(name, []).append(tile)
        ego_from_world = invert_pose(drive.world_from_ego.at(drive.time_s[frame]))
        for lidar in self.lidars:
            points = shown.returns(lidar, frame)
            if points is None:
                continue
            points = np.column_stack([transform_points(ego_from_world, points[:, :3]), points[:, 3]])
            labels = label_sweep(drive, frame, drive.lidars[lidar].model.sweep_s, self._returns[frame])
            count("lidar", "bev", labels, self.detector.in_sweep(points), lidar)


def _returns(sweep: LidarFrame | None) -> FloatArray | None:
    if sweep is None:
        return None
    on = sweep.returned
    points = sweep.origins[on] + sweep.directions[on] * sweep.depth_m[on, None].astype(np.float64)
    return np.column_stack([points, sweep.intensity[on]])


def _outlined(rgb: NDArray[np.uint8], boxes: FloatArray) -> NDArray[np.uint8]:
    """Return an image with the outlines of boxes (N, 4)."""
    out, (height, width) = rgb.copy(), rgb.shape[:2]
    for left, top, right, bottom in np.clip(boxes.round().astype(int), 0, [width - 1, height - 1] * 2).tolist():
        out[top : bottom + 1, [left, right]] = out[[top, bottom], left : right + 1] = OUTLINE
    return out


def curves(recalls: Mapping[str, Mapping[Key, Recall]], clear: Mapping[float, Collection[int]]) -> dict[str, Any]:
    """Return ``curves``, metrics by sensor and class, row, and shift, and ``lost_per_metre`` by the former two.

    The least score is that of the best F1 in recorded frames. At a shift, what was recorded is of the same frames as all
    else, those in ``clear``.
    """
    metrics: dict[str, dict[str, dict[str, Any]]] = {}
    slopes: dict[str, dict[str, dict[str, Any]]] = {}
    for (kind, group, _), recorded in recalls[RECORDED].items():
        least, title = recorded.least_score(), f"{kind}, {group}"
        for name, row in recalls.items():
            points = {shift: r for (k, g, shift), r in sorted(row.items()) if (k, g) == (kind, group)}
            if name == RECORDED:
                points = {shift: recorded.of_frames(frames) for shift, frames in sorted(clear.items())}
            else:
                slopes.setdefault(title, {})[name] = lost_per_metre(points, least, recorded)
            at = {f"{shift:+g}": recall.metrics(least, recorded) for shift, recall in points.items()}
            metrics.setdefault(title, {})[name] = at
    return {"curves": metrics, "lost_per_metre": slopes}


def tables(document: Mapping[str, Any]) -> list[str]:
    """Return curves as tables in Markdown: recall, its interval, false alarms a frame, and what is lost a metre."""
    lines: list[str] = []
    for title, rows in document["curves"].items():
        shifts = sorted({shift for row in rows.values() for shift in row}, key=float)
        lines += [f"{title}: recall, % (95 % of resampled actors), false alarms a frame", ""]
        lines += ["| | " + " | ".join(f"{shift} m" for shift in shifts) + " | lost a metre |"]
        lines += ["|---" * (len(shifts) + 2) + "|"]
        for name, row in rows.items():
            lost = document["lost_per_metre"].get(title, {}).get(name)
            cells = [*(_cell(row.get(shift)) for shift in shifts), _percent(lost, 1)]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
        lines.append("")
    return lines


def _cell(at: Mapping[str, Any] | None) -> str:
    if at is None or at["recall"]["value"] is None:
        return ""
    return f"{_percent(at['recall'], 0)}, {at['false_alarms']:.1f}"


def _percent(of: Mapping[str, Any] | None, digits: int) -> str:
    """Return a share and its interval in per cent; "" where there is none."""
    if of is None or of["value"] is None:
        return ""
    value, low, high = (f"{100 * part:.{digits}f}" for part in (of["value"], *of["interval"]))
    return f"{value} ({low} … {high})"


def write_plot(path: Path, curves: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
    """Plot recall by the shift, intervals as bands; nothing without matplotlib, which the extra `bench` brings."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return
    figure = Figure(figsize=(5.2 * max(1, len(curves)), 4.0), layout="constrained")
    for number, (title, rows) in enumerate(curves.items()):
        axes = figure.add_subplot(1, len(curves), number + 1)
        for colour, (name, row) in enumerate(rows.items()):
            points = [(float(shift), at["recall"]) for shift, at in row.items() if at["recall"]["value"] is not None]
            x, y = [shift for shift, _ in points], [100 * recall["value"] for _, recall in points]
            low, high = ([100 * recall["interval"][end] for _, recall in points] for end in (0, 1))
            line = "ko:" if name == RECORDED else f"C{colour}o{'--' if name == TRUTH else '-'}"
            axes.plot(x, y, line, markersize=4, label=name)
            axes.fill_between(x, low, high, color=f"C{colour}", alpha=0.1)
        axes.set(xlabel="metres to the left of the path", ylabel="recall, %", title=title, ylim=(0, 102))
        axes.grid(True, alpha=0.2)
        axes.legend(frameon=False, fontsize=8)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    write_file(path, file.getvalue())
