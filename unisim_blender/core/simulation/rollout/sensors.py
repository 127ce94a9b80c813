"""Deliver the captures of a simulation's sensors: rendered of the world's own drive and written as a sequence's are, or without
the actors that are hidden from a sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray
from PIL import Image as PillowImage

from ...colour import bytes_from_srgb
from ...errors import OutputError, SimulationError
from ...formats.rendered import camera_path, lidar_path
from ...output.frame_files import sweep_points
from ...render.captures import started_ahead
from ...render.renderer import Renderer
from ...render.reuse import FrameReuse
from ...sensors.frames import CameraFrame, LidarFrame
from ...sensors.unprojection import image_mask
from ...sequence.manifest import LABELS
from ...sequence.plan import CaptureIdentities, RenderPlan
from ...sequence.records import CaptureRecord, read_records
from ...sequence.run import Work, capture_renderer, render_moment
from ...world.captures import Capture, CaptureKey, Moment
from ...world.drive import Drive
from ..clock import Exposure
from ..drivers.driver import POINT_FIELDS, CameraImage, LidarSweep

SweepPoints = NDArray[np.void] | NpzFile
"""A sweep's points by the names of their fields: records, or a file of them."""


RECORDS = 64
"""Largest number of moments whose records stay in memory: captures of one moment end at different times, and it has one
record."""


class SensorSource(Protocol):
    """Delivers what exposures see. ``unsupported`` is the share of unsupported pixels of each camera's image of the last call of
    `render`, ``confidence`` the mean confidence of each sensor's pixels or returns, where they are known."""

    unsupported: dict[str, float]
    confidence: dict[str, float]

    def render(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """Return what exposures see of a world's drive, in their order."""

    def read(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """Return the same of exposures that an earlier run has rendered. Raises `OutputError` where it is not there."""


@dataclass
class SimulatedSensors:
    """Renders exposures, into folder ``out`` where there is one. ``plan`` and ``renderer`` are the rollout's."""

    plan: RenderPlan
    renderer: Renderer
    out: Path | None
    unsupported: dict[str, float] = field(default_factory=dict)
    """The share of unsupported pixels of each camera's image of the last call of `render`."""
    confidence: dict[str, float] = field(default_factory=dict)
    """The mean confidence of the pixels, or returns, of each sensor's frame of the last call of `render`."""
    frames: dict[str, CameraFrame | LidarFrame] = field(default_factory=dict)
    """Frames of the last call of `render`, by the sensors' names; of several frames of a sensor, the last one."""
    reuse: FrameReuse | None = field(default_factory=FrameReuse)
    """The last frames, of which parts are reused while sensors stand; None where all frames are rendered whole."""
    _done: dict[CaptureKey, dict[str, CaptureRecord]] = field(default_factory=dict)

    def render(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """Render what ended in a world's drive, write it, and return it as drivers get it, in the order of the exposures."""
        plan = replace(self.plan, drive=drive, captures=self.plan.captures.of_drive(drive))
        start = capture_renderer(plan, self.renderer, self.reuse)
        identities = None if self.out is None else CaptureIdentities(plan)
        images, sweeps = [], []
        self.unsupported, self.confidence, self.frames = {}, {}, {}
        ahead = started_ahead(start, (exposure.capture for exposure in exposures))
        for exposure, waits in zip(exposures, ahead, strict=True):
            if identities is None or self.out is None:
                shot = waits()
            else:
                shot = self._written(identities, waits, exposure, self.out)
            sensor_id = exposure.capture.sensor_id
            self.frames[sensor_id] = shot
            confidence = self._confidence(plan, exposure.capture, shot)
            if confidence is not None and confidence.size:
                shown = None if isinstance(shot, LidarFrame) else image_mask(shot.model)
                self.confidence[sensor_id] = float((confidence if shown is None else confidence[shown]).mean())
            if isinstance(shot, LidarFrame):
                sweeps.append(delivered_sweep(exposure, sweep_points(shot), confidence))
                continue
            if shot.unsupported is not None:
                self.unsupported[exposure.capture.sensor_id] = float(np.mean(shot.unsupported))
            images.append(delivered_image(exposure, bytes_from_srgb(shot.rgb), confidence))
        return images, sweeps

    def _confidence(
        self, plan: RenderPlan, capture: Capture, shot: CameraFrame | LidarFrame | None = None
    ) -> NDArray[np.float32] | None:
        """Return the confidence of an image's pixels (H, W), or of a sweep's returns (N,), where it was asked for; without a
        frame, of one that is rendered again."""
        if "confidence" not in plan.settings.passes:
            return None
        shot = capture_renderer(plan, self.renderer, None)(capture)() if shot is None else shot
        if isinstance(shot, CameraFrame):
            return shot.confidence
        lidar = plan.captures.lidar(capture.sensor_id)
        every = self.renderer.sweep_confidence(plan.captures.state(lidar, capture.time_s(lidar)), shot)
        return None if every is None else every[shot.returned]

    def _written(
        self,
        identities: CaptureIdentities,
        waits: Callable[[], CameraFrame | LidarFrame],
        exposure: Exposure,
        out: Path,
    ) -> CameraFrame | LidarFrame:
        plan = identities.plan
        name, _ = capture_name(plan.drive, exposure.capture)
        moment = moment_of(plan.drive, exposure.capture)
        while len(self._done) > RECORDS and moment.key not in self._done:
            del self._done[next(iter(self._done))]
        there = self._done.setdefault(moment.key, {})
        wanted = {known: (record.identity, record.sees) for known, record in there.items() if known != LABELS}
        wanted[name] = identities.of_moment(moment)[name]
        shots = []

        def written(name: str, shot: CameraFrame | LidarFrame, record: CaptureRecord) -> None:
            shots.append(shot)
            there[name] = record

        render_moment(plan, lambda capture: waits, out, Work(moment, wanted, dict(there)), written)
        return shots[0]

    def read(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """Return what was delivered by exposures that an earlier run rendered, from the folder's files. Raises `OutputError`."""
        images, sweeps = [], []
        assert self.out is not None
        if not self._done:
            self._done = read_records(self.out)
        plan = replace(self.plan, drive=drive, captures=self.plan.captures.of_drive(drive))
        for exposure in exposures:
            sensor_id, moment = exposure.capture.sensor_id, moment_of(drive, exposure.capture)
            name, is_camera = capture_name(drive, exposure.capture)
            record = self._done.get(moment.key, {}).get(name)
            if record is None or not record.is_whole(self.out):
                raise OutputError(f"{self.out}: {name} of {moment.name} is missing or was changed; name another folder")
            confidence = self._confidence(plan, exposure.capture)
            if is_camera:
                rgb = np.asarray(PillowImage.open(camera_path(self.out, sensor_id, moment.name, ".png")).convert("RGB"))
                images.append(delivered_image(exposure, rgb, confidence))
            else:
                with np.load(lidar_path(self.out, sensor_id, moment.name, ".npz")) as file:
                    sweeps.append(delivered_sweep(exposure, file, confidence))
        return images, sweeps


def capture_name(drive: Drive, capture: Capture) -> tuple[str, bool]:
    """Return the name that records have for a capture, and whether it is a camera's."""
    is_camera = capture.sensor_id in drive.cameras
    return f"{'camera' if is_camera else 'lidar'}/{capture.sensor_id}", is_camera


def moment_of(drive: Drive, capture: Capture) -> Moment:
    """Return the moment of one capture alone."""
    is_camera = capture.sensor_id in drive.cameras
    return Moment.at(drive, capture.time_us, *(([capture.sensor_id], []) if is_camera else ([], [capture.sensor_id])))


def delivered_image(
    exposure: Exposure, rgb: NDArray[np.uint8], confidence: NDArray[np.float32] | None = None
) -> CameraImage:
    """Return an image as drivers get it."""
    capture = exposure.capture
    return CameraImage(capture.sensor_id, capture.time_us, exposure.start_us, exposure.end_us, rgb, confidence)


def delivered_sweep(
    exposure: Exposure, points: SweepPoints, confidence: NDArray[np.float32] | None = None
) -> LidarSweep:
    """Return a sweep as drivers get it: what a return belongs to is not measured."""
    capture = exposure.capture
    records = without_instances(points)
    return LidarSweep(capture.sensor_id, capture.time_us, exposure.start_us, exposure.end_us, records, confidence)


def without_instances(points: SweepPoints) -> NDArray[np.void]:
    """Return a sweep's points as records (N,) of `POINT_FIELDS`."""
    records = np.zeros(len(points["x"]), POINT_FIELDS)
    for name in POINT_FIELDS.names or ():
        records[name] = points[name]
    return records


@dataclass
class HiddenActors:
    """Delivers what ``sensors`` do, without the actors that are ``hidden`` from them: identifiers by the sensor's name.

    A rollout's scenario cannot say what was hidden: `finish` would render these captures anew, with the actors.
    """

    sensors: SensorSource
    hidden: Mapping[str, AbstractSet[str]]
    unsupported: dict[str, float] = field(default_factory=dict)
    confidence: dict[str, float] = field(default_factory=dict)

    def render(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """See `SensorSource.render`. Raises `SimulationError` for a sensor or an actor that the drive does not have."""
        return self._delivered(drive, exposures, renders=True)

    def read(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        return self._delivered(drive, exposures, renders=False)

    def _delivered(
        self, drive: Drive, exposures: Sequence[Exposure], renders: bool
    ) -> tuple[list[CameraImage], list[LidarSweep]]:
        for name, uids in self.hidden.items():
            if name not in drive.cameras and name not in drive.lidars:
                raise SimulationError(f'hidden actors: there is no sensor "{name}"')
            for uid in uids - drive.actors.keys():
                raise SimulationError(f'hidden actors: there is no actor "{uid}" to hide from {name}')
        images, sweeps = [], []
        unsupported: dict[str, float] = {}
        confidence: dict[str, float] = {}
        for exposure in exposures:
            seen = without_actors(drive, self.hidden.get(exposure.capture.sensor_id, frozenset()))
            delivered = self.sensors.render(seen, [exposure]) if renders else self.sensors.read(seen, [exposure])
            images += delivered[0]
            sweeps += delivered[1]
            unsupported |= self.sensors.unsupported
            confidence |= self.sensors.confidence
        self.unsupported, self.confidence = unsupported, confidence
        return images, sweeps


def without_actors(drive: Drive, uids: AbstractSet[str]) -> Drive:
    """Return a drive without some of its actors."""
    if not uids:
        return drive
    return replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid not in uids})
