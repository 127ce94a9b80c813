"""The driver `egodriver`: any process that serves AlpaSim's `egodriver.EgodriverService`. We are its runtime.

Needs the package `carla-driver-interface` (the extra ``alpasim``). The frame ``local`` is the world seen from above: poses have
z 0, neither roll nor pitch. LiDAR sweeps travel in ``renderer_data``, as drivers of that package read them.
"""

from __future__ import annotations

import io
import math
import uuid
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image as PillowImage

from ...errors import SimulationError, UnisimError, in_a_line
from ...geometry import FloatArray, angles_from_rotation, make_pose, quaternion_from_yaw
from ..states import EgoState
from ..vehicle.actions import Control, Plan
from ..world import Action
from .driver import CameraImage, Driver, DriverKind, DriverSetup, EgoMotion, Endpoint, LidarSweep, Observation, register

if TYPE_CHECKING:
    from ...lenses.lens import Lens

CONNECT_S = 20.0
"""Longest wait for a driver's first answer."""
CALL_S = 300.0
"""Longest time of a call, as in AlpaSim."""
ROUTE_M = 100.0
"""Length of the route ahead that is submitted."""
MOST_POSES = 10_000
"""Largest number of poses of a plan."""
PLAN_S = 3600.0
"""Latest pose of a plan, seconds ahead."""
HOLD_M_S2 = 3.0
"""How a vehicle brakes whose driver has ended its session."""


class EgodriverDriver:
    """Asks a driver over gRPC. Its first call starts the session, which `close` ends."""

    def __init__(self, endpoint: Endpoint, setup: DriverSetup) -> None:
        from ...formats.alpasim import messages
        from ...formats.alpasim.endpoints import channel_to

        self._protos, self._setup, self._where = messages, setup, f"--driver-address {endpoint.address}"
        self._session, self._ended, self._history = str(uuid.uuid4()), False, setup.history
        self._rig_from_axle = np.eye(4)
        self._rig_from_axle[2, 3] = setup.rear_axle_height_m
        cameras = self._cameras()
        self._channel = channel_to(endpoint.address, endpoint.authority, "--driver-address")
        try:
            stub: Any = messages.EgodriverStub
            self._stub = stub(self._channel)
            self._start(cameras)
        except BaseException:
            self._channel.close()
            raise

    def drive(self, observation: Observation) -> Action:
        """See `Driver.drive`. An empty plan means to stop where the vehicle is; a driver that ends its session is asked no more,
        and its vehicle brakes. Raises `SimulationError` for a driver that fails, or answers with no plan."""
        if self._ended:
            return Control(-HOLD_M_S2, 0.0)
        ego, messages = observation.ego, self._protos.egodriver
        history, self._history = self._history, ()
        self._call("submit_egomotion_observation", self._motion((*history, *observation.motion)))
        route = messages.Route(timestamp_us=observation.time_us, waypoints=self._route(ego))
        self._call("submit_route", messages.RouteRequest(session_uuid=self._session, route=route))
        for image in observation.images:
            self._call("submit_image_observation", self._image(image))
        request = messages.DriveRequest(
            session_uuid=self._session,
            time_now_us=observation.time_us,
            time_query_us=observation.time_us + self._setup.step_us,
        )
        if observation.sweeps:
            sweeps = [self._sweep(sweep) for sweep in observation.sweeps]
            data = self._protos.RendererData(snapshot_timestamp_us=observation.time_us, lidar=sweeps)
            request.renderer_data = data.SerializeToString()
        answer = self._call("drive", request)
        self._ended = bool(answer.terminate_session)
        return self._plan(answer.trajectory, observation.time_us, ego)

    def close(self) -> None:
        import grpc

        try:
            request = self._protos.egodriver.DriveSessionCloseRequest(session_uuid=self._session)
            self._stub.close_session(request, timeout=CONNECT_S)
        except grpc.RpcError:
            pass  # it is gone, and its session with it
        finally:
            self._channel.close()

    def _start(self, cameras: list[Any]) -> None:
        import grpc

        messages = self._protos
        try:
            _, revision = messages.negotiate(self._stub, timeout=CONNECT_S)
            request = messages.egodriver.DriveSessionRequest(session_uuid=self._session, random_seed=self._setup.seed)
            declared = messages.cameras_to_revision(cameras, messages.CONTRACT_REVISION, revision)
            request.rollout_spec.vehicle.available_cameras.extend(declared)
            self._stub.start_session(request, timeout=CALL_S, metadata=messages.contract_metadata(revision))
        except messages.ContractError as error:
            raise UnisimError(f"{self._where}: {in_a_line(error)}") from error
        except grpc.RpcError as error:
            raise UnisimError(self._failure("start_session", error)) from error

    def _call(self, name: str, request: Any) -> Any:
        import grpc

        try:
            return getattr(self._stub, name)(request, timeout=CALL_S)
        except grpc.RpcError as error:
            raise SimulationError(self._failure(name, error)) from error

    def _failure(self, name: str, error: Any) -> str:
        details = in_a_line(Exception(error.details() or "no details"))
        return f"{self._where}: {name}: {error.code().name}: {details}"

    def _cameras(self) -> list[Any]:
        from ...formats.alpasim.messages import FieldError, camera_message, pose_message
        from ...world.drive import CameraModel

        kind = self._protos.sensorsim.AvailableCamerasReturn.AvailableCamera
        messages = []
        for name, sensor in self._setup.sensors.items():
            if not isinstance(sensor.model, CameraModel):
                continue
            try:
                spec = camera_message(name, sensor.model)
            except FieldError as fault:
                lens: Lens = sensor.model.lens
                raise UnisimError(
                    f"--driver egodriver: {fault}; choose other sensors with --sensors, or another lens than {lens.TYPE}"
                ) from fault
            pose = pose_message(self._rig_from_axle @ sensor.rear_axle_from_sensor)
            messages.append(kind(logical_id=name, intrinsics=spec, rig_to_camera=pose))
        return messages

    def _motion(self, motion: tuple[EgoMotion, ...]) -> Any:
        from ...formats.alpasim.messages import trajectory_message, vector_message

        request = self._protos.egodriver.RolloutEgoTrajectory(session_uuid=self._session)
        states = [moment.state for moment in motion]
        poses = [
            make_pose(np.array([state.x_m, state.y_m, 0.0]), quaternion_from_yaw(state.heading_rad)) for state in states
        ]
        request.trajectory.CopyFrom(trajectory_message([moment.time_us for moment in motion], poses))
        for state in states:
            turning = state.speed_m_s * self._setup.vehicle.curvature(state.steering_rad, state.speed_m_s)
            request.dynamic_states.append(
                self._protos.common.DynamicState(
                    linear_velocity=vector_message((state.speed_m_s, 0.0, 0.0)),
                    angular_velocity=vector_message((0.0, 0.0, turning)),
                    linear_acceleration=vector_message((state.acceleration_m_s2, state.speed_m_s * turning, 0.0)),
                )
            )
        return request

    def _image(self, image: CameraImage) -> Any:
        file = io.BytesIO()
        PillowImage.fromarray(image.rgb).save(file, "PNG", compress_level=1)
        request = self._protos.egodriver.RolloutCameraImage(session_uuid=self._session)
        sent = request.camera_image
        sent.logical_id, sent.image_bytes = image.sensor_id, file.getvalue()
        sent.frame_start_us, sent.frame_end_us = max(image.start_us, 0), max(image.end_us, 0)
        return request

    def _sweep(self, sweep: LidarSweep) -> Any:
        from ...formats.alpasim.messages import sweep_message

        pose = self._rig_from_axle @ self._setup.sensors[sweep.sensor_id].rear_axle_from_sensor
        points = np.stack([sweep.points[name] for name in "xyz"], -1).astype(np.float64)
        return sweep_message(sweep.sensor_id, max(sweep.time_us, 0), pose, points, sweep.points["intensity"])

    def _route(self, ego: EgoState) -> list[Any]:
        """Return the route ahead as messages of points in the rig's frame."""
        from ...formats.alpasim.messages import vector_message

        points = _ahead(self._setup.route, ego)
        return [vector_message((x, y, 0.0)) for x, y in points.tolist()]

    def _plan(self, trajectory: Any, now_us: int, ego: EgoState) -> Plan:
        from ...formats.alpasim.messages import FieldError, pose_of

        poses = trajectory.poses
        if len(poses) > MOST_POSES:
            raise SimulationError(f"{self._where}: drive: a plan has at most {MOST_POSES} poses, not {len(poses)}")
        if not poses:
            return Plan.at_rest(now_us, ego)
        times = [int(pose.timestamp_us) for pose in poses]
        latest = now_us + round(PLAN_S * 1e6)
        late = next((time_us for time_us in times if time_us > latest), None)
        if late is not None:
            raise SimulationError(f"{self._where}: drive: a plan's pose at {late} us is over {PLAN_S:g} s ahead")
        try:
            matrices = np.stack([pose_of(pose.pose, f"trajectory.poses[{i}].pose") for i, pose in enumerate(poses)])
            headings = angles_from_rotation(matrices[:, :3, :3])[0]
            return Plan(np.array(times, np.int64), matrices[:, 0, 3], matrices[:, 1, 3], headings)
        except (FieldError, SimulationError) as fault:
            raise SimulationError(f"{self._where}: drive: {fault}") from fault


def _ahead(route: FloatArray, ego: EgoState) -> FloatArray:
    """Return the points (P, 2) of the next `ROUTE_M` of a route in the rig's frame: the first is the nearest to the vehicle."""
    legs = np.diff(route, axis=0)
    lengths = np.maximum(np.hypot(*legs.T), 1e-9)
    place = np.array([ego.x_m, ego.y_m])
    u = np.clip(((place - route[:-1]) * legs).sum(-1) / lengths**2, 0.0, 1.0)
    feet = route[:-1] + u[:, None] * legs
    nearest = int(np.argmin(np.hypot(*(place - feet).T)))
    points = np.concatenate([feet[nearest : nearest + 1], route[nearest + 1 :]])
    points = points[np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))) <= ROUTE_M]
    c, s = math.cos(ego.heading_rad), math.sin(ego.heading_rad)
    turned: FloatArray = (points - place) @ np.array([[c, -s], [s, c]])
    return turned


def _nowhere(setup: DriverSetup) -> Driver:
    raise AssertionError(f"a driver with {len(setup.sensors)} sensors has no address")


EGODRIVER = register(
    DriverKind(
        "egodriver",
        "AlpaSim's protocol, a process at --driver-address",
        _nowhere,
        remote=lambda endpoint: partial(EgodriverDriver, endpoint),
    )
)
