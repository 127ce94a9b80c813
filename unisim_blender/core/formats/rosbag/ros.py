"""Messages of a run as ROS 2's, with their topics."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from ..common.messages import (
    POINT_FIELDS,
    REAR_AXLE,
    SECOND_NS,
    WORLD,
    ImageMessage,
    LabelledBox,
    MessageEncoder,
    OpenCVCalibration,
    PlannedPoses,
    Pose,
    RolloutEgo,
    SweepMessage,
    colour_of,
    point_layout,
)

TYPES: Any = get_typestore(Stores.ROS2_HUMBLE)


class RosEncoder(MessageEncoder):
    """Messages of `rosbags`. ROS has no other characters in names of topics than letters, digits and underscores."""

    camera_info, image = "camera_info", "image/compressed"

    def __init__(self) -> None:
        self._topics: dict[tuple[str, str], str] = {}

    def topic(self, kind: str, sensor_id: str) -> str:
        """Return "/camera/NAME" of a sensor; names that become the same are numbered."""
        if (kind, sensor_id) not in self._topics:
            name = re.sub(r"[^A-Za-z0-9_]", "_", sensor_id)
            name = f"_{name}" if name[:1].isdigit() or not name else name
            taken, wanted, number = set(self._topics.values()), f"/{kind}/{name}", 2
            while wanted in taken:
                wanted, number = f"/{kind}/{name}_{number}", number + 1
            self._topics[kind, sensor_id] = wanted
        return self._topics[kind, sensor_id]

    def transforms(self, time_ns: int, poses: Mapping[str, Pose], parent: str = WORLD) -> Any:
        transforms = [_transform(time_ns, name, pose, parent) for name, pose in poses.items()]
        return _of("tf2_msgs/TFMessage", transforms=transforms)

    def boxes(self, time_ns: int, boxes: Sequence[LabelledBox]) -> Any:
        actions = TYPES.types["visualization_msgs/msg/Marker"]
        first = _marker(time_ns, "", 0, actions.DELETEALL, None)
        marks = [_marker(time_ns, box.label, number, actions.ADD, box) for number, box in enumerate(boxes)]
        return _of("visualization_msgs/MarkerArray", markers=[first, *marks])

    def calibration(self, message: ImageMessage, calibration: OpenCVCalibration) -> Any:
        region = _of("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return _of(
            "sensor_msgs/CameraInfo",
            header=_header(message.time_ns, message.sensor_id),
            height=message.model.height,
            width=message.model.width,
            distortion_model=calibration.distortion,
            d=np.array(calibration.coefficients, np.float64),
            k=np.array(calibration.matrix),
            r=np.eye(3).reshape(-1),
            p=np.array(calibration.projection),
            binning_x=0,
            binning_y=0,
            roi=region,
        )

    def compressed_image(self, message: ImageMessage) -> Any:
        header, data = _header(message.time_ns, message.sensor_id), np.frombuffer(message.path.read_bytes(), np.uint8)
        return _of("sensor_msgs/CompressedImage", header=header, format="png", data=data)

    def point_cloud(self, message: SweepMessage) -> Any:
        types = TYPES.types["sensor_msgs/msg/PointField"]
        numbers = {"<f4": types.FLOAT32, "<f8": types.FLOAT64, "<i4": types.INT32}
        fields = [
            _of("sensor_msgs/PointField", name=name, offset=offset, datatype=numbers[kind], count=1)
            for name, kind, offset in point_layout()
        ]
        count, step = len(message.points), POINT_FIELDS.itemsize
        return _of(
            "sensor_msgs/PointCloud2",
            header=_header(message.time_ns, message.sensor_id),
            height=1,
            width=count,
            fields=fields,
            is_bigendian=False,
            point_step=step,
            row_step=step * count,
            data=np.frombuffer(message.points.tobytes(), np.uint8),
            is_dense=True,
        )

    def odometry(self, message: RolloutEgo) -> Any:
        zeros = np.zeros(36)
        linear, angular = _vector((message.speed_m_s, 0.0, 0.0)), _vector((0.0, 0.0, message.yaw_rate_rad_s))
        twist = _of("geometry_msgs/Twist", linear=linear, angular=angular)
        return _of(
            "nav_msgs/Odometry",
            header=_header(message.time_ns, WORLD),
            child_frame_id=REAR_AXLE,
            pose=_of("geometry_msgs/PoseWithCovariance", pose=_pose(message.pose), covariance=zeros),
            twist=_of("geometry_msgs/TwistWithCovariance", twist=twist, covariance=zeros),
        )

    def path(self, message: PlannedPoses) -> Any:
        poses = [
            _of("geometry_msgs/PoseStamped", header=_header(time_ns, WORLD), pose=_pose(pose))
            for time_ns, pose in zip(message.times_ns, message.poses, strict=True)
        ]
        return _of("nav_msgs/Path", header=_header(message.time_ns, WORLD), poses=poses)


def _marker(time_ns: int, namespace: str, number: int, action: int, box: LabelledBox | None) -> Any:
    """A cube; ``text``, which ROS does not draw of cubes, is the actor's id."""
    r, g, b, a = (0.0, 0.0, 0.0, 0.0) if box is None else colour_of(box)
    pose = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)) if box is None else box.pose
    return _of(
        "visualization_msgs/Marker",
        header=_header(time_ns, WORLD),
        ns=namespace,
        id=number,
        type=TYPES.types["visualization_msgs/msg/Marker"].CUBE,
        action=action,
        pose=_pose(pose),
        scale=_vector((1.0, 1.0, 1.0) if box is None else box.size_m),
        color=_of("std_msgs/ColorRGBA", r=r, g=g, b=b, a=a),
        lifetime=_of("builtin_interfaces/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=_of("sensor_msgs/CompressedImage", header=_header(0, ""), format="", data=np.zeros(0, np.uint8)),
        uv_coordinates=[],
        text="" if box is None else box.uid,
        mesh_resource="",
        mesh_file=_of("visualization_msgs/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )


def _of(kind: str, /, **values: Any) -> Any:
    package, _, name = kind.partition("/")
    return TYPES.types[f"{package}/msg/{name}"](**values)


def _header(time_ns: int, frame: str) -> Any:
    seconds, rest = divmod(time_ns, SECOND_NS)
    return _of("std_msgs/Header", stamp=_of("builtin_interfaces/Time", sec=seconds, nanosec=rest), frame_id=frame)


def _vector(values: tuple[float, float, float], kind: str = "Vector3") -> Any:
    x, y, z = values
    return _of(f"geometry_msgs/{kind}", x=x, y=y, z=z)


def _quaternion(pose: Pose) -> Any:
    w, x, y, z = pose.quaternion_wxyz
    return _of("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)


def _pose(pose: Pose) -> Any:
    return _of("geometry_msgs/Pose", position=_vector(pose.position, "Point"), orientation=_quaternion(pose))


def _transform(time_ns: int, child: str, pose: Pose, parent: str) -> Any:
    moved = _of("geometry_msgs/Transform", translation=_vector(pose.position), rotation=_quaternion(pose))
    return _of("geometry_msgs/TransformStamped", header=_header(time_ns, parent), child_frame_id=child, transform=moved)
