"""AlpaSim's `SensorsimService`: its calls, and the status that each fault is answered with."""

from __future__ import annotations

import asyncio
import hmac
import io
import logging
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import grpc
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..colour import bytes_from_srgb
from ..errors import UnisimError, in_a_line, short
from ..formats.alpasim import messages
from ..formats.alpasim.endpoints import MOST_BYTES
from ..formats.alpasim.messages import FieldError, camera_message, pose_message, sweep_message, trajectory_message
from ..output.frame_files import sweep_points
from ..render.captures import render_sweep
from ..world.captures import microseconds
from .requests import ImageRequest, SweepRequest, image_request, sweep_request
from .scenes import ServedScene
from .turns import BusyError, FairQueue, Wanted

BAND = 64
"""Rows between two looks at whether an image is still wanted."""


class NotWantedError(Exception):
    """Nobody waits for what is rendered."""


def image_bytes(request: ImageRequest, wanted: Wanted) -> bytes:
    """Render an image as a file. Raises `NotWantedError` soon after ``wanted`` has become false."""
    renderer, states = request.scene.renderer, request.scene.captures.of_drive(request.drive)
    camera = states.camera(request.capture.sensor_id)
    time_s = request.capture.time_s(camera)
    parts = []
    for tile in renderer.progressive(states.state(camera, time_s), camera, time_s, ("rgb",), band=BAND):
        if not wanted():
            raise NotWantedError
        parts.append(bytes_from_srgb(tile.frame.rgb))
    return encoded(np.concatenate(parts), request.format, request.quality)


def encoded(rgb: NDArray[np.uint8], kind: str, quality: float) -> bytes:
    """Return an image (H, W, 3) as a file: "PNG", "JPEG", or "RGB_UINT8_PLANAR", which is (3, H, W) without a header."""
    if kind == "RGB_UINT8_PLANAR":
        return np.ascontiguousarray(np.moveaxis(rgb, -1, 0)).tobytes()
    file = io.BytesIO()
    if kind == "PNG":
        Image.fromarray(rgb).save(file, "PNG", compress_level=1)
    else:
        Image.fromarray(rgb).save(file, "JPEG", quality=round(quality))
    return file.getvalue()


def sweep_returns(request: SweepRequest, wanted: Wanted) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Render a sweep: the returns (N, 3) in the LiDAR's frame at the sweep's end, and their intensities (N,) from 0 to 1."""
    if not wanted():
        raise NotWantedError
    scene = request.scene
    sweep = render_sweep(scene.renderer, scene.captures.of_drive(request.drive), request.capture, scene.draw)
    points = sweep_points(sweep)
    return np.stack([points[name] for name in "xyz"], -1).astype(np.float32), points["intensity"].astype(np.float32)


SERVICE = "nre.grpc.protos.sensorsim.SensorsimService"
MOST_ITEMS = 64
"""Largest number of items of a batch, and of each kind of an aggregated request."""

Status = grpc.StatusCode
ServicerContext = Any
logger = logging.getLogger(__name__)


class UnknownSceneError(Exception):
    """There is no scene of an id."""


class TooLargeError(Exception):
    """An answer has more bytes than a message may have."""


@dataclass(frozen=True, eq=False)
class Caller:
    """Who asks, and until when the answer is waited for, a time of `time.monotonic`."""

    client: str
    until: float


@dataclass(frozen=True, eq=False)
class Sensorsim:
    """The service of scenes by their ids. ``token``: what a caller has to state, if anything. A call takes at most ``call_s``
    seconds."""

    scenes: dict[str, ServedScene]
    turns: FairQueue
    call_s: float
    token: str | None = None

    def handler(self) -> Any:
        """Return gRPC's handler of all calls. Requests come as bytes: what cannot be parsed is answered like any other fault."""
        calls: dict[str, tuple[Any, Callable[[Any, Caller], Awaitable[Any]]]] = {
            "render_rgb": (messages.sensorsim.RGBRenderRequest, self.render_rgb),
            "render_lidar": (messages.sensorsim.LidarRenderRequest, self.render_lidar),
            "render_aggregated": (messages.sensorsim.AggregatedRenderRequest, self.render_aggregated),
            "batch_render_rgb": (messages.sensorsim.BatchRGBRenderRequest, self.batch_render_rgb),
            "get_version": (messages.common.Empty, self.get_version),
            "get_available_scenes": (messages.common.Empty, self.get_available_scenes),
            "get_loaded_scenes": (messages.common.Empty, self.get_loaded_scenes),
            "get_available_cameras": (messages.sensorsim.AvailableCamerasRequest, self.get_available_cameras),
            "get_available_trajectories": (
                messages.sensorsim.AvailableTrajectoriesRequest,
                self.get_available_trajectories,
            ),
            "get_available_ego_masks": (messages.common.Empty, self.get_available_ego_masks),
        }
        methods = {
            name: grpc.unary_unary_rpc_method_handler(self._answering(kind, call))
            for name, (kind, call) in calls.items()
        }
        return grpc.method_handlers_generic_handler(SERVICE, methods)

    def _answering(
        self, kind: Any, call: Callable[[Any, Caller], Awaitable[Any]]
    ) -> Callable[[bytes, ServicerContext], Awaitable[bytes]]:
        async def answer(request: bytes, context: ServicerContext) -> bytes:
            if not self._allowed(context):
                await context.abort(Status.UNAUTHENTICATED, "authorization: must be Bearer and the server's token")
            status, details = Status.INTERNAL, "an error of the server, which its log has"
            try:
                left_s = context.time_remaining()
                caller = Caller(
                    context.peer(), time.monotonic() + min(self.call_s, self.call_s if left_s is None else left_s)
                )
                message = kind.FromString(request)
                sent: bytes = (await call(message, caller)).SerializeToString()
                if len(sent) > MOST_BYTES:
                    raise TooLargeError
                return sent
            except messages.DecodeError:
                status, details = Status.INVALID_ARGUMENT, f"request: is no {kind.DESCRIPTOR.name}"
            except FieldError as fault:
                status, details = Status.INVALID_ARGUMENT, in_a_line(fault)
            except UnknownSceneError as fault:
                status, details = Status.NOT_FOUND, in_a_line(fault)
            except BusyError as fault:
                status, details = Status.RESOURCE_EXHAUSTED, in_a_line(fault)
            except TooLargeError:
                status, details = Status.RESOURCE_EXHAUSTED, f"the answer has more than {MOST_BYTES} bytes"
            except (asyncio.TimeoutError, NotWantedError):
                status, details = Status.DEADLINE_EXCEEDED, "was not rendered in time"
            except UnisimError as fault:
                details = in_a_line(fault)
            except Exception:
                logger.exception("a call failed")
            await context.abort(status, details)
            raise AssertionError("abort raises")

        return answer

    def _allowed(self, context: ServicerContext) -> bool:
        if self.token is None:
            return True
        stated = dict(context.invocation_metadata() or ()).get("authorization", "")
        stated = stated if isinstance(stated, bytes) else stated.encode()
        return hmac.compare_digest(stated, f"Bearer {self.token}".encode())

    def _scene(self, scene_id: str, field: str = "scene_id") -> ServedScene:
        if scene_id not in self.scenes:
            raise UnknownSceneError(f"{field}: {short(scene_id)} is not one of {', '.join(self.scenes)}")
        return self.scenes[scene_id]

    async def _image(self, message: Any, caller: Caller, at: str = "") -> bytes:
        """Return the file of an image; ``at`` goes before the names of the message's fields."""
        scene = self._scene(message.scene_id, f"{at}scene_id")

        def work(wanted: Wanted) -> bytes:
            return image_bytes(image_request(scene, message, at), wanted)

        return await self.turns.run(caller.client, work, caller.until)

    async def _sweep(self, message: Any, caller: Caller, at: str = "") -> tuple[Any, Any]:
        """Return a sweep's answer, and its message for drivers; ``at`` as of `_image`."""
        scene = self._scene(message.scene_id, f"{at}scene_id")

        def work(wanted: Wanted) -> tuple[Any, Any]:
            request = sweep_request(scene, message, at)
            points, intensity = sweep_returns(request, wanted)
            name, time_us = request.capture.sensor_id, request.capture.time_us
            mount = scene.rig_from_sensor[name]
            for_drivers = sweep_message(name, time_us, mount, points.astype(np.float64), intensity)
            return _sweep_answer(points, intensity), for_drivers

        return await self.turns.run(caller.client, work, caller.until)

    async def render_rgb(self, message: Any, caller: Caller) -> Any:
        """Render an image."""
        return messages.sensorsim.RGBRenderReturn(image_bytes=await self._image(message, caller))

    async def render_lidar(self, message: Any, caller: Caller) -> Any:
        """Render a sweep."""
        answer, _ = await self._sweep(message, caller)
        return answer

    async def render_aggregated(self, message: Any, caller: Caller) -> Any:
        """Render images and sweeps; the sweeps are also in ``driver_data``, as drivers of `carla-driver-interface` read them."""
        for name, items in (("rgb_requests", message.rgb_requests), ("lidar_requests", message.lidar_requests)):
            if len(items) > MOST_ITEMS:
                raise FieldError(name, f"must be at most {MOST_ITEMS}, not {len(items)}")
        renders = messages.sensorsim.AggregatedRenderReturn()
        for number, request in enumerate(message.rgb_requests):
            renders.rgb_returns.add(image_bytes=await self._image(request, caller, f"rgb_requests[{number}]."))
        sweeps = []
        for number, request in enumerate(message.lidar_requests):
            answer, sweep = await self._sweep(request, caller, f"lidar_requests[{number}].")
            renders.lidar_returns.append(answer)
            sweeps.append(sweep)
        if sweeps:
            latest = max(sweep.timestamp_us for sweep in sweeps)
            renders.driver_data = messages.RendererData(snapshot_timestamp_us=latest, lidar=sweeps).SerializeToString()
        return renders

    async def batch_render_rgb(self, message: Any, caller: Caller) -> Any:
        """Render several images; each is answered with its own success or fault."""
        if len(message.items) > MOST_ITEMS:
            raise FieldError("items", f"must be at most {MOST_ITEMS}, not {len(message.items)}")
        batch = messages.sensorsim.BatchRGBRenderReturn()
        for number, item in enumerate(message.items):
            answer = batch.items.add(camera_name=item.camera_name)
            try:
                answer.result.image_bytes = await self._image(item.request, caller, f"items[{number}].request.")
                answer.success = True
            except (FieldError, UnknownSceneError) as fault:
                answer.error_message = in_a_line(fault)
        return batch

    async def get_version(self, message: Any, caller: Caller) -> Any:
        """Tell this package's version, and that of AlpaSim's messages."""
        del message, caller
        name = f"unisim_blender-{version('unisim_blender')}"
        return messages.common.VersionId(version_id=name, grpc_api_version=messages.API_VERSION)

    async def get_available_scenes(self, message: Any, caller: Caller) -> Any:
        """List the scenes' ids."""
        del message, caller
        return messages.common.AvailableScenesReturn(scene_ids=list(self.scenes))

    async def get_loaded_scenes(self, message: Any, caller: Caller) -> Any:
        """List the scenes again: all stay loaded."""
        del message, caller
        kind = messages.sensorsim.LoadedSceneEntry
        loaded = [kind(scene_id=name, loaded_instance_count=1, reusable_instance_count=1) for name in self.scenes]
        return messages.sensorsim.LoadedScenesReturn(scenes=loaded, loaded_instance_capacity=len(loaded))

    async def get_available_cameras(self, message: Any, caller: Caller) -> Any:
        """List a scene's cameras that AlpaSim has a lens for, with their recorded models and mounts."""
        del caller
        scene = self._scene(message.scene_id)
        answer = messages.sensorsim.AvailableCamerasReturn()
        for name, camera in scene.drive.cameras.items():
            try:
                spec = camera_message(name, camera.model)
            except FieldError:
                continue
            mount = pose_message(scene.rig_from_sensor[name])
            answer.available_cameras.add(intrinsics=spec, rig_to_camera=mount, logical_id=name)
        return answer

    async def get_available_trajectories(self, message: Any, caller: Caller) -> Any:
        """Give the recorded trajectory of the rig."""
        del caller
        track = self._scene(message.scene_id).world_from_rig
        times = [microseconds(time_s) for time_s in track.times_s.tolist()]
        keys = [(time_us, pose) for time_us, pose in zip(times, track.poses, strict=True) if time_us >= 0]
        answer = messages.sensorsim.AvailableTrajectoriesReturn()
        answer.available_trajectories.add(trajectory=trajectory_message(*zip(*keys, strict=True)) if keys else None)
        return answer

    async def get_available_ego_masks(self, message: Any, caller: Caller) -> Any:
        """List no masks: there are none."""
        del message, caller
        return messages.sensorsim.AvailableEgoMasksReturn()


def _sweep_answer(points: NDArray[np.float32], intensity: NDArray[np.float32]) -> Any:
    """Return the answer of a sweep, its numbers in the fields of bytes alone: as lists, too, they would take twice as much."""
    return messages.sensorsim.LidarRenderReturn(
        num_points=len(points),
        point_xyzs_buffer=points.astype("<f4").tobytes(),
        point_intensities_buffer=intensity.astype("<f4").tobytes(),
    )
