"""AlpaSim's renderer service over gRPC: what it renders, where everything is then, what it refuses and whom."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from drive_frames import DriveFrames
from numpy.typing import NDArray
from PIL import Image
from self_signed import certificate
from served_scenes import call, fault_of, served

from unisim_blender.core.cli.main import run
from unisim_blender.core.colour import bytes_from_srgb
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.formats.alpasim import messages
from unisim_blender.core.formats.alpasim.messages import pose_message
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.serve.scenes import ServedScene
from unisim_blender.core.serve.server import Listening

SIM = messages.sensorsim
CAMERA, LIDAR = "front_camera", "pandar64"


@pytest.fixture(scope="module")
def channel(scenes: dict[str, ServedScene]) -> Iterator[Any]:
    with served(scenes) as address, grpc.insecure_channel(address) as found:
        yield found


def pair(start: FloatArray, end: FloatArray) -> Any:
    return SIM.PosePair(start_pose=pose_message(start), end_pose=pose_message(end))


def objects(scene: ServedScene, start_us: int, end_us: int) -> list[Any]:
    moving = [actor for actor in scene.drive.actors.values() if actor.is_moving]
    poses = [[actor.world_from_actor.at(time_us / 1e6) for time_us in (start_us, end_us)] for actor in moving]
    return [SIM.DynamicObject(track_id=a.uid, pose_pair=pair(*two)) for a, two in zip(moving, poses, strict=True)]


def image_message(channel: Any, scene: ServedScene, frame: int = 2) -> Any:
    """The request of a recorded image, with the camera that the service offers."""
    cameras = call(
        channel,
        "get_available_cameras",
        SIM.AvailableCamerasRequest(scene_id=scene.scene_id),
        SIM.AvailableCamerasReturn,
    ).available_cameras
    (camera,) = [one for one in cameras if one.logical_id == CAMERA]
    recorded = scene.drive.cameras[CAMERA]
    start, end = recorded.model.shutter.exposure_s(recorded.time_s[frame])
    start_us, end_us = round(start * 1e6), round(end * 1e6)
    return SIM.RGBRenderRequest(
        scene_id=scene.scene_id,
        resolution_w=camera.intrinsics.resolution_w,
        resolution_h=camera.intrinsics.resolution_h,
        camera_intrinsics=camera.intrinsics,
        frame_start_us=start_us,
        frame_end_us=end_us,
        sensor_pose=pair(*(recorded.world_from_camera.at(time_us / 1e6) for time_us in (start_us, end_us))),
        dynamic_objects=objects(scene, start_us, end_us),
        image_format=SIM.ImageFormat.Value("PNG"),
    )


def pixels(data: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(np.float64)


@pytest.fixture(scope="module")
def scene(scenes: dict[str, ServedScene]) -> ServedScene:
    (found,) = scenes.values()
    return found


@pytest.fixture(scope="module")
def image(channel: Any, scene: ServedScene) -> Any:
    return image_message(channel, scene)


@pytest.fixture(scope="module")
def rendered(channel: Any, image: Any) -> NDArray[np.float64]:
    return pixels(call(channel, "render_rgb", image, SIM.RGBRenderReturn).image_bytes)


def test_the_recorded_image_is_the_replays(rendered: NDArray[np.float64], scene: ServedScene) -> None:
    """Poses travel as float32, and the path during an exposure as its two ends: some pixels differ by a little."""
    replayed = bytes_from_srgb(DriveFrames(scene.renderer, scene.drive).camera(CAMERA, 2).rgb).astype(float)
    assert rendered.shape == replayed.shape
    assert np.abs(rendered - replayed).mean() < 0.5 < np.abs(rendered - replayed.mean()).mean()


def test_objects_are_where_the_request_has_them(
    channel: Any, image: Any, scene: ServedScene, rendered: NDArray[np.float64]
) -> None:
    alone = SIM.RGBRenderRequest.FromString(image.SerializeToString())
    del alone.dynamic_objects[:]
    without = pixels(call(channel, "render_rgb", alone, SIM.RGBRenderReturn).image_bytes)
    assert np.abs(without - rendered).max() > 20
    moved = SIM.RGBRenderRequest.FromString(alone.SerializeToString())
    place = np.eye(4)
    place[:3, 3] = [scene.drive.world_from_ego.at(0.2)[0, 3] + 9.0, 0.3, 0.8]
    moved.dynamic_objects.add(track_id="car-01", pose_pair=pair(place, place))
    changed = np.abs(pixels(call(channel, "render_rgb", moved, SIM.RGBRenderReturn).image_bytes) - without).max(-1) > 8
    assert changed.mean() > 0.02
    # a static track belongs to the scene, and can be moved all the same
    parked = SIM.RGBRenderRequest.FromString(alone.SerializeToString())
    parked.dynamic_objects.add(track_id="car-06", pose_pair=pair(place, place))
    assert np.abs(pixels(call(channel, "render_rgb", parked, SIM.RGBRenderReturn).image_bytes) - without).max() > 8


def test_sizes_formats_and_shutters(channel: Any, image: Any) -> None:
    small = SIM.RGBRenderRequest.FromString(image.SerializeToString())
    small.resolution_w, small.resolution_h = 32, 18
    small.image_format, small.image_quality = SIM.ImageFormat.Value("JPEG"), 90
    assert pixels(call(channel, "render_rgb", small, SIM.RGBRenderReturn).image_bytes).shape == (18, 32, 3)
    small.image_format = SIM.ImageFormat.Value("PNG")
    png = pixels(call(channel, "render_rgb", small, SIM.RGBRenderReturn).image_bytes)
    small.image_format = SIM.ImageFormat.Value("RGB_UINT8_PLANAR")
    planes = np.frombuffer(call(channel, "render_rgb", small, SIM.RGBRenderReturn).image_bytes, np.uint8)
    assert np.array_equal(np.moveaxis(planes.reshape(3, 18, 32), 0, -1), png)
    small.image_format = SIM.ImageFormat.Value("PNG")
    seen = set()
    for name in ("GLOBAL", "ROLLING_LEFT_TO_RIGHT", "ROLLING_RIGHT_TO_LEFT", "ROLLING_BOTTOM_TO_TOP"):
        small.camera_intrinsics.shutter_type = SIM.ShutterType.Value(name)
        small.frame_end_us = small.frame_start_us + 1_000_000
        small.sensor_pose.end_pose.vec.x = small.sensor_pose.start_pose.vec.x + 2.0
        seen.add(call(channel, "render_rgb", small, SIM.RGBRenderReturn).image_bytes)
    assert len(seen) == 4


def sweep_message(scene: ServedScene) -> Any:
    track = scene.drive.lidars[LIDAR].world_from_lidar
    return SIM.LidarRenderRequest(
        scene_id=scene.scene_id,
        frame_start_us=100_000,
        frame_end_us=200_000,
        sensor_pose=pair(track.at(0.1), track.at(0.2)),
        dynamic_objects=objects(scene, 100_000, 200_000),
    )


def test_a_sweep_and_all_at_once(channel: Any, image: Any, scene: ServedScene, rendered: NDArray[np.float64]) -> None:
    sweep = call(channel, "render_lidar", sweep_message(scene), SIM.LidarRenderReturn)
    points = np.frombuffer(sweep.point_xyzs_buffer, "<f4").reshape(-1, 3)
    assert sweep.num_points == len(points) > 5000
    assert len(sweep.point_intensities_buffer) == 4 * len(points)
    replayed = DriveFrames(scene.renderer, scene.drive).lidar(LIDAR, 2)
    assert abs(len(points) - int(replayed.returned.sum())) < 0.01 * len(points)
    lengths = np.sort(np.linalg.norm(points, axis=1))
    assert abs(np.median(lengths) - np.median(replayed.depth_m[replayed.returned])) < 0.1
    both = SIM.AggregatedRenderRequest(rgb_requests=[image], lidar_requests=[sweep_message(scene)])
    answer = call(channel, "render_aggregated", both, SIM.AggregatedRenderReturn)
    assert np.array_equal(pixels(answer.rgb_returns[0].image_bytes), rendered)
    assert answer.lidar_returns[0] == sweep
    (told,) = messages.RendererData.FromString(answer.driver_data).lidar
    in_rig = np.frombuffer(told.points_xyzi, "<f4").reshape(-1, 4)
    assert told.num_points == len(points) and abs(np.quantile(in_rig[:, 2], 0.05)) < 0.05


def test_a_batch_answers_each_item(channel: Any, image: Any, rendered: NDArray[np.float64]) -> None:
    elsewhere = SIM.RGBRenderRequest.FromString(image.SerializeToString())
    elsewhere.scene_id = "moon"
    items = [SIM.BatchRGBRenderRequestItem(camera_name=n, request=r) for n, r in (("a", image), ("b", elsewhere))]
    found = call(channel, "batch_render_rgb", SIM.BatchRGBRenderRequest(items=items), SIM.BatchRGBRenderReturn).items
    assert [(one.camera_name, one.success) for one in found] == [("a", True), ("b", False)]
    assert np.array_equal(pixels(found[0].result.image_bytes), rendered)
    assert found[1].error_message == "items[1].request.scene_id: 'moon' is not one of street"


def test_what_there_is(channel: Any, scene: ServedScene) -> None:
    empty = messages.common.Empty()
    assert call(channel, "get_version", empty, messages.common.VersionId).version_id.startswith("unisim_blender-")
    listed = call(channel, "get_available_scenes", empty, messages.common.AvailableScenesReturn)
    assert list(listed.scene_ids) == ["street"]
    loaded = call(channel, "get_loaded_scenes", empty, SIM.LoadedScenesReturn)
    assert [(one.scene_id, one.loaded_instance_count) for one in loaded.scenes] == [("street", 1)]
    assert not call(channel, "get_available_ego_masks", empty, SIM.AvailableEgoMasksReturn).ego_mask_metadata
    asked = SIM.AvailableTrajectoriesRequest(scene_id="street")
    (found,) = call(
        channel, "get_available_trajectories", asked, SIM.AvailableTrajectoriesReturn
    ).available_trajectories
    last = found.trajectory.poses[-1]
    place = scene.drive.world_from_ego.at(last.timestamp_us / 1e6)[:3, 3]
    assert np.allclose([last.pose.vec.x, last.pose.vec.y, last.pose.vec.z], place, atol=0.05)


def edited(image: Any, **fields: Any) -> Any:
    """A copy of a request with fields set: "a__b" is b of a."""
    found = SIM.RGBRenderRequest.FromString(image.SerializeToString())
    for path, value in fields.items():
        *outer, name = path.split("__")
        at = found
        for one in outer:
            at = getattr(at, one)
        setattr(at, name, value)
    return found


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"camera_intrinsics__logical_id": "rear"}, "camera_intrinsics.logical_id: 'rear' is not one of front_camera"),
        ({"camera_intrinsics__shutter_type": 0}, "camera_intrinsics.shutter_type: must be GLOBAL or one of"),
        ({"camera_intrinsics__opencv_pinhole_param__focal_length_x": 0.0}, "camera_intrinsics.opencv_pinhole_param: "),
        ({"camera_intrinsics__ftheta_param__max_angle": 1.0}, "camera_intrinsics.ftheta_param.reference_poly: must be"),
        ({"insert_ego_mask": True}, "insert_ego_mask: there are no masks"),
        ({"image_format": 5}, "image_format: AVC is not one of PNG, JPEG, RGB_UINT8_PLANAR"),
        ({"image_format": 0}, "image_format: UNDEFINED (a request that leaves it out) is not one of PNG, JPEG, RGB_"),
        ({"image_format": 77}, "image_format: 77 is not one of PNG"),
        ({"image_quality": 900.0}, "image_quality: must lie from 1 to 100, not 900"),
        ({"resolution_w": 1 << 24}, "resolution_w: 16777216 x 36 pixels are more than"),
        (
            {"resolution_w": 128},
            "resolution_w: 128 x 36 pixels have another ratio than the lens's 64 x 36: it would be",
        ),
        ({"resolution_w": 32, "resolution_h": 36}, "resolution_w: 32 x 36 pixels have another ratio than the lens's"),
        (
            {"camera_intrinsics__resolution_h": 0},
            "camera_intrinsics.resolution_h: must be the lens's own size in pixels",
        ),
        (
            {
                "camera_intrinsics__opencv_pinhole_param__principal_point_x": 0.0,
                "camera_intrinsics__opencv_pinhole_param__principal_point_y": 0.0,
            },
            "camera_intrinsics.opencv_pinhole_param.principal_point_x: no principal point is given: it is 0, 0",
        ),
        (
            {
                "sensor_pose__start_pose__quat__w": 0.0,
                "sensor_pose__start_pose__quat__x": 0.0,
                "sensor_pose__start_pose__quat__y": 0.0,
                "sensor_pose__start_pose__quat__z": 0.0,
            },
            "sensor_pose.start_pose.quat: must be a unit quaternion, not [0.0, 0.0, 0.0, 0.0]",
        ),
        ({"resolution_h": 0}, "resolution_h: must be 1 or more, not 0"),
        ({"frame_end_us": 0}, "frame_end_us: must lie from 0 to 10000000 us after the start"),
        ({"frame_start_us": 1 << 63}, "frame_start_us: must be at most"),
        ({"sensor_pose__start_pose__quat__w": 7.0}, "sensor_pose.start_pose.quat: must be a unit quaternion"),
        ({"sensor_pose__end_pose__vec__x": float("inf")}, "sensor_pose.end_pose.vec: must be finite"),
    ],
)
def test_what_cannot_be_done_is_named(channel: Any, image: Any, fields: dict[str, Any], field: str) -> None:
    status, details = fault_of(channel, "render_rgb", edited(image, **fields))
    assert status == "INVALID_ARGUMENT" and details.startswith(field), (status, details)


def test_more_that_is_named(channel: Any, image: Any, scene: ServedScene) -> None:
    assert fault_of(channel, "render_rgb", edited(image, scene_id="moon")) == (
        "NOT_FOUND", "scene_id: 'moon' is not one of street",
    )  # fmt: skip
    behind = SIM.RGBRenderRequest.FromString(image.SerializeToString())
    behind.camera_intrinsics.bivariate_windshield_model_param.SetInParent()
    assert "windshields are not modelled" in fault_of(channel, "render_rgb", behind)[1]
    stranger = SIM.RGBRenderRequest.FromString(image.SerializeToString())
    stranger.dynamic_objects[1].track_id = "nobody"
    assert (
        fault_of(channel, "render_rgb", stranger)[1] == "dynamic_objects[1].track_id: the scene has no actor 'nobody'"
    )
    device = sweep_message(scene)
    device.lidar_config.lidar_type = SIM.LidarDeviceType.Value("AT128")
    status, details = fault_of(channel, "render_lidar", device)
    assert status == "INVALID_ARGUMENT" and details.startswith("lidar_config.lidar_type: AT128: the scene has no LiDAR")
    assert fault_of(channel, "render_rgb", b"\xff\xff") == ("INVALID_ARGUMENT", "request: is no RGBRenderRequest")
    assert fault_of(channel, "shut_down", b"")[0] == "UNIMPLEMENTED"
    many = SIM.BatchRGBRenderRequest(items=[SIM.BatchRGBRenderRequestItem()] * 65)
    assert fault_of(channel, "batch_render_rgb", many)[1] == "items: must be at most 64, not 65"
    assert fault_of(channel, "render_rgb", bytes(9 << 20))[0] == "RESOURCE_EXHAUSTED"


def test_a_greedy_client_waits_for_itself(scenes: dict[str, ServedScene], image: Any) -> None:
    """One that has filled its queue is refused more, while another one is served."""
    large = edited(image, resolution_w=640, resolution_h=360)
    options = [("grpc.use_local_subchannel_pool", 1)]
    with served(scenes) as address, ThreadPoolExecutor(40) as pool:
        with grpc.insecure_channel(address, options) as greedy, grpc.insecure_channel(address, options) as other:
            asked = [pool.submit(fault_of, greedy, "render_rgb", large, timeout=8) for _ in range(30)]
            small = edited(image, resolution_w=16, resolution_h=9)
            assert call(other, "render_rgb", small, timeout=60)
            statuses = {one.result()[0] for one in asked}
    assert "RESOURCE_EXHAUSTED" in statuses and statuses <= {"OK", "RESOURCE_EXHAUSTED", "DEADLINE_EXCEEDED"}


def test_time_is_bounded(scenes: dict[str, ServedScene], image: Any) -> None:
    with served(scenes, call_s=0.05) as address, grpc.insecure_channel(address) as channel:
        large = edited(image, resolution_w=1920, resolution_h=1080)
        assert fault_of(channel, "render_rgb", large) == ("DEADLINE_EXCEEDED", "was not rendered in time")


def test_tls_and_token(scenes: dict[str, ServedScene], tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    token = "correct-horse-battery"
    where = Listening("0.0.0.0", 0, cert, key, token)
    empty = messages.common.Empty()
    with served(scenes, where) as address:
        with grpc.insecure_channel(address) as plain:
            assert fault_of(plain, "get_version", empty, timeout=10)[0] in ("UNAVAILABLE", "DEADLINE_EXCEEDED")
        credentials = grpc.ssl_channel_credentials(cert.read_bytes())
        with grpc.secure_channel(address, credentials) as channel:
            assert fault_of(channel, "get_version", empty)[0] == "UNAUTHENTICATED"
            wrong, right = ((("authorization", f"Bearer {one}"),) for one in ("wrong", token))
            assert fault_of(channel, "get_version", empty, metadata=wrong)[0] == "UNAUTHENTICATED"
            assert call(channel, "get_version", empty, metadata=right)


def test_other_machines_take_tls_and_a_token(tmp_path: Path) -> None:
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    lacking: list[dict[str, Any]] = [{}, {"certificate": cert, "key": key}, {"token": "x" * 20}]
    for more in lacking:
        with pytest.raises(UnisimError, match="which takes --tls-cert, --tls-key and --token-file"):
            Listening("0.0.0.0", 1, **more)
    with pytest.raises(UnisimError, match="at least 16"):
        Listening(token="short")
    with pytest.raises(UnisimError, match="give both or neither"):
        Listening(certificate=cert)


def test_a_taken_port_is_told(scenes: dict[str, ServedScene]) -> None:
    with served(scenes) as address:
        port = int(address.rpartition(":")[2])
        with pytest.raises(UnisimError, match="cannot be listened at"), served(scenes, Listening(port=port)):
            pass


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_signal_ends_the_command(street: Path) -> None:
    program = "import sys; from unisim_blender.core.cli.main import run; sys.exit(run(sys.argv[1:]))"
    asked = ["serve", str(street), "--port", "0", "--renderer", "surfel", "--quality", "fast", "--sensors", CAMERA]
    line, ended = signalled(signal.SIGTERM, program, *asked)
    assert line.startswith("Serving street at 127.0.0.1:") and ended == (0, "Stopped.\n", "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_so_does_an_interrupt() -> None:
    program = """
from unisim_blender.core.serve.server import Listening, serve_until_signalled
serve_until_signalled({}, Listening(), 10.0, lambda port: print(f"at 127.0.0.1:{port};"))
print("Stopped.")
"""
    _, ended = signalled(signal.SIGINT, program)
    assert ended == (0, "Stopped.\n", "")


def signalled(number: signal.Signals, program: str, *arguments: str) -> tuple[str, tuple[int, str, str]]:
    """Run a server in an interpreter, call it once and send it a signal: its first line, and how it ended."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-c", program, *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        with grpc.insecure_channel(line.split("at ")[-1].partition(";")[0]) as channel:
            assert call(channel, "get_version", messages.common.Empty())
        process.send_signal(number)
        out, err = process.communicate(timeout=120)
    return line, (process.returncode, out, err)


def test_refused_before_anything_is_served(street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["serve", str(street), "--host", "0.0.0.0"]) == 1
    assert "--host 0.0.0.0: other machines could reach it" in capsys.readouterr().err
    assert run(["serve", str(tmp_path / "nothing.json")]) == 1
    assert "nothing.json" in capsys.readouterr().err
