"""Benchmark cases: render requests that take turns, so that whatever else the machine does affects all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import SceneError
from unisim_blender.core.evaluation.recorded import recorded_image
from unisim_blender.core.model.scene_file import WEIGHTS_NAME, SceneHeader, read_scene_header
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.quality import QUALITIES, TRUTH_QUALITY
from unisim_blender.core.world.drive import CameraModel, Drive

from .render_request import Measurement, RenderRequest, SceneSetup
from .settings import DEFAULT, DOUBLED, GPU, TYPICAL, BenchmarkMethod, Settings
from .state_cost import AddedActors


@dataclass
class CaseEntry:
    """A render request, the process that it is rendered in, and what came of it so far. ``about`` tells the
    metrics what it is."""

    about: dict[str, Any]
    process: str
    request: RenderRequest
    once: bool = False
    """The truth is no faster for being rendered again."""
    fresh: bool = False
    """In a process of its own, which has held nothing before."""
    measurements: list[Measurement] = field(default_factory=list)


@dataclass
class BenchmarkCase:
    """Entries that take turns. ``kind`` is a section of the metrics; ``recorded`` are what a log has
    instead of the windows."""

    kind: str
    about: dict[str, Any]
    entries: list[CaseEntry]
    recorded: list[NDArray[np.float32]] | None = None


@dataclass(frozen=True)
class Subject:
    """A scene with the sensors and the frame that are rendered of it."""

    header: SceneHeader
    camera: str
    model: CameraModel
    lidar: str | None
    lidar_size: tuple[int, int]
    frame: int
    log: Log | None = None

    def setup(self, method: BenchmarkMethod | None = None, threads: int = 1) -> SceneSetup:
        """Where a method renders it; without one, the compiled tracer."""
        log = None if self.log is None else self.log.path
        tracer, threads = ("compiled", threads) if method is None else (method.tracer, method.threads)
        return SceneSetup(self.header.path, self.camera, self.frame, tracer, threads, log)


def subject_of(scene: Path, log: Log | None = None) -> Subject:
    """The first camera and the first LiDAR with beams that the scene was trained on, at the drive's middle frame that
    both have. Raises `SceneError`."""
    header = read_scene_header(scene)
    drive: Drive = header.drive
    cameras = [name for name in header.training.get("cameras", ()) if name in drive.cameras] or list(drive.cameras)
    if not cameras:
        raise SceneError(f"{scene}: has no camera")
    camera = drive.cameras[cameras[0]]
    lidars = [lidar for lidar in drive.lidars.values() if lidar.model.beams]
    lidar = lidars[0] if lidars else None
    frames = [frame for frame in drive.frames if frame in camera.time_s and (lidar is None or frame in lidar.time_s)]
    if log is not None:
        frames = [frame for frame in frames if frame in log.image_frames(camera.sensor_id)]
    if not frames:
        raise SceneError(f"{scene}: has no frame that its sensors share")
    size = (0, 0) if lidar is None else (lidar.model.beams, lidar.model.columns)
    name = None if lidar is None else lidar.sensor_id
    return Subject(header, camera.sensor_id, camera.model, name, size, frames[len(frames) // 2], log)


def windows(width: int, height: int, counts: tuple[int, int], size: tuple[int, int]) -> tuple[Region, ...]:
    """Regions of ``size`` (width, height), evenly spread in ``counts`` (columns, rows); no larger than the image."""
    w, h = min(size[0], width), min(size[1], height)
    lefts = [round((i + 0.5) * width / counts[0] - w / 2) for i in range(counts[0])]
    tops = [round((j + 0.5) * height / counts[1] - h / 2) for j in range(counts[1])]
    lefts, tops = ([min(max(0, a), end) for a in x] for x, end in ((lefts, width - w), (tops, height - h)))
    return tuple(Region(left, top, left + w, top + h) for top in tops for left in lefts)


def middle(width: int, height: int, share: float) -> Region:
    """A region in an image's middle, of its proportions and this share of its area."""
    w, h = max(1, round(width * share**0.5)), max(1, round(height * share**0.5))
    left, top = (width - w) // 2, (height - h) // 2
    return Region(left, top, left + w, top + h)


def all_cases(
    subjects: Sequence[Subject], methods: Sequence[BenchmarkMethod], settings: Settings
) -> list[BenchmarkCase]:
    """Return every measurement of `unisim bench`, in the order in which they are made. A step of the closed loop and memory are
    measured on a GPU, too, where one of the methods is its own.

    All cases are measured on the first subject, each method in those that compare methods. The other subjects are
    rendered in one case only, which compares scenes of different sizes (`scenes_case`).
    """
    first = subjects[0]
    threads, gpu = max(method.threads for method in methods), any(method.tracer == GPU for method in methods)
    cases = [camera_case(first, methods, settings, width, threads) for width in settings.widths]
    if first.lidar is not None:
        cases.append(lidar_case(first, methods, settings, threads))
    cases += [pixels_case(first, settings, threads)]
    if first.header.drive.actors:
        cases += [copies_case(first, settings, threads), state_case(first, settings, threads)]
    cases += [region_case(first, settings, threads), scenes_case(subjects, settings, threads)]
    if first.lidar is not None:
        cases.append(loop_case(first, settings, threads, gpu))
    cases.append(memory_case(first, settings, threads, gpu))
    return cases


def _of_method(method: BenchmarkMethod) -> dict[str, Any]:
    return {
        "method": method.name,
        "tracer": method.tracer,
        "variant": method.variant,
        "threads": method.threads,
        "scaled": not method.whole,
    }


def _against_truth(subject: Subject, methods: Sequence[BenchmarkMethod], request: RenderRequest) -> list[CaseEntry]:
    """The render request by every method, after the truth and twice the truth's samples."""
    truths = [
        CaseEntry({"truth": name}, DEFAULT, replace(request, quality=quality, whole=False), once=True)
        for name, quality in (("truth", TRUTH_QUALITY), ("doubled", DOUBLED))
    ]
    return truths + [
        CaseEntry(
            _of_method(method),
            method.process,
            replace(request, setup=subject.setup(method), quality=method.quality, whole=method.whole),
        )
        for method in methods
    ]


def camera_case(
    subject: Subject, methods: Sequence[BenchmarkMethod], settings: Settings, width: int, threads: int
) -> BenchmarkCase:
    """Images of one width."""
    model = subject.model.resized(width)
    regions = windows(width, model.height, settings.windows, settings.window)
    request = RenderRequest(subject.setup(threads=threads), subject.camera, TRUTH_QUALITY, width, regions)
    recorded = None
    if subject.log is not None:
        image = recorded_image(subject.log, subject.camera, subject.frame, width)
        recorded = [image[r.top : r.bottom, r.left : r.right] for r in regions]
    about = {"sensor": subject.camera, "frame": subject.frame, "width": width, "height": model.height}
    return BenchmarkCase("camera", about, _against_truth(subject, methods, request), recorded)


def lidar_case(subject: Subject, methods: Sequence[BenchmarkMethod], settings: Settings, threads: int) -> BenchmarkCase:
    """Sweeps."""
    assert subject.lidar is not None
    request = RenderRequest(
        subject.setup(threads=threads), subject.lidar, TRUTH_QUALITY, column_step=settings.column_step
    )
    beams, columns = subject.lidar_size
    about = {"sensor": subject.lidar, "frame": subject.frame, "beams": beams, "columns": columns}
    return BenchmarkCase("lidar", about, _against_truth(subject, methods, request))


def _typical(subject: Subject, width: int, threads: int, regions: tuple[Region, ...] = ()) -> RenderRequest:
    return RenderRequest(subject.setup(threads=threads), subject.camera, QUALITIES[TYPICAL], width, regions)


def pixels_case(subject: Subject, settings: Settings, threads: int) -> BenchmarkCase:
    """Images of growing width."""
    entries = [
        CaseEntry(
            {"width": width, "height": subject.model.resized(width).height}, DEFAULT, _typical(subject, width, threads)
        )
        for width in settings.growth_widths
    ]
    return BenchmarkCase("pixels", {}, entries)


def copies_case(subject: Subject, settings: Settings, threads: int) -> BenchmarkCase:
    """An image with more and more copies of an actor, in view and behind the camera."""
    request = _typical(subject, settings.growth_width, threads)
    entries = [
        CaseEntry(
            {"copies": copies, "behind": behind},
            DEFAULT,
            replace(request, setup=replace(request.setup, copies=copies, behind=behind)),
        )
        for copies in settings.copies
        for behind in ((False, True) if copies else (False,))
    ]
    return BenchmarkCase("copies", {"width": settings.growth_width}, entries)


def state_case(subject: Subject, settings: Settings, threads: int) -> BenchmarkCase:
    """Return the case that measures the cost of a state of many actors, for a sweep and for an image."""
    added = AddedActors(settings.state_actors, settings.state_repeats)
    model = subject.model.resized(settings.state_width)
    shot = replace(_typical(subject, settings.state_width, threads), added=added)
    entries = [CaseEntry({"sensor": "camera", "columns": model.width, "rows": model.height}, DEFAULT, shot, once=True)]
    if subject.lidar is not None:
        beams, columns = subject.lidar_size
        sweep = replace(shot, sensor=subject.lidar, width=0)
        entries.insert(0, CaseEntry({"sensor": "lidar", "columns": columns, "rows": beams}, DEFAULT, sweep, once=True))
    return BenchmarkCase("state", {"frame": subject.frame, "repeats": added.repeats}, entries)


def region_case(subject: Subject, settings: Settings, threads: int) -> BenchmarkCase:
    """An image, and shares of it rendered alone."""
    width, height = settings.growth_width, subject.model.resized(settings.growth_width).height
    regions = tuple(middle(width, height, share) for share in settings.shares)
    entries = [CaseEntry({"share": None}, DEFAULT, _typical(subject, width, threads, regions))]
    for share, region in zip(settings.shares, regions, strict=True):
        request = replace(_typical(subject, width, threads, (region,)), whole=False)
        entries.append(CaseEntry({"share": share}, DEFAULT, request))
    return BenchmarkCase("region", {"width": width, "height": height}, entries)


def scenes_case(subjects: Sequence[Subject], settings: Settings, threads: int) -> BenchmarkCase:
    """An image and a sweep of each scene."""
    entries = []
    for subject in subjects:
        header = subject.header
        about = {
            "scene": header.name,
            "path": str(header.path),
            "weights_bytes": (header.path / WEIGHTS_NAME).stat().st_size,
            "volume_m3": float(np.prod(header.volume["size_m"])),
            "actors": len(header.drive.actors),
        }
        image = _typical(subject, settings.growth_width, threads)
        entries.append(CaseEntry({**about, "sensor": "camera"}, DEFAULT, image))
        if subject.lidar is not None:
            sweep = replace(image, sensor=subject.lidar, width=0)
            entries.append(CaseEntry({**about, "sensor": "lidar"}, DEFAULT, sweep))
    return BenchmarkCase("scenes", {"width": settings.growth_width}, entries)


def loop_case(subject: Subject, settings: Settings, threads: int, gpu: bool = False) -> BenchmarkCase:
    """Steps of the closed loop with an image and a sweep, at every quality, and again on a ``gpu``."""
    assert subject.lidar is not None
    request = _typical(subject, settings.loop_width, threads)
    request = replace(request, steps=settings.loop_steps, beside=subject.lidar)
    entries = [
        CaseEntry(
            {"quality": name, "method": f"{by} {name}"},
            process,
            replace(request, setup=replace(request.setup, tracer=tracer), quality=quality),
            once=True,
        )
        for by, process, tracer in (("native", DEFAULT, "compiled"), *((("GPU", GPU, GPU),) if gpu else ()))
        for name, quality in QUALITIES.items()
    ]
    return BenchmarkCase("loop", {"width": settings.loop_width}, entries)


def memory_case(subject: Subject, settings: Settings, threads: int, gpu: bool = False) -> BenchmarkCase:
    """A large image and a sweep, each in a process of its own, and again on a ``gpu``."""
    width = settings.memory_width
    image, entries = _typical(subject, width, threads), list[CaseEntry]()
    for process, tracer, by in ((DEFAULT, "compiled", ""), *(((GPU, GPU, ", GPU"),) if gpu else ())):
        asked = replace(image, setup=replace(image.setup, tracer=tracer))
        entries.append(CaseEntry({"what": f"image, {width} wide{by}"}, process, asked, once=True, fresh=True))
        if subject.lidar is not None:
            sweep = replace(asked, sensor=subject.lidar, width=0)
            entries.append(CaseEntry({"what": f"sweep{by}"}, process, sweep, once=True, fresh=True))
    return BenchmarkCase("memory", {}, entries)
