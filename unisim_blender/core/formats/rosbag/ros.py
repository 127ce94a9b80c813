"""Messages of a run as ROS 2's, with their topics."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from ..common.calibration import calibration_of
from ..common.messages import (
    EGO,
    POINT_FIELDS,
    REAR_AXLE,
    WORLD,
    BoxLabels,
    ImageMessage,
    LabelledBox,
    Message,
    Mounts,
    PlannedPoses,
    Pose,
    RolloutEgo,
    SweepMessage,
    colour_of,
    frame_of,
)

TYPES: Any = get_typestore(Stores.ROS2_HUMBLE)
TRANSFORMS, MOUNTS, BOXES, EGO_STATE, EGO_PLAN = "/tf", "/tf_static", "/boxes", "/ego/state", "/ego/plan"
SECOND_NS = 1_000_000_000

RosMessages = Iterator[tuple[str, Any]]
"""Topics, and messages of `rosbags`."""


class Topics:
    """Names of topics, in which ROS has no other characters than letters, digits and underscores."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, str], str] = {}

    def of(self, kind: str, sensor_id: str) -> str:
        """Return "/camera/NAME" of a sensor; names that become the same are numbered."""
        if (kind, sensor_id) not in self._names:
            name = re.sub(r"[^A-Za-z0-9_]", "_", sensor_id)
            name = f"_{name}" if name[:1].isdigit() or not name else name
            taken, wanted, number = set(self._names.values()), f"/{kind}/{name}", 2
            while wanted in taken:
                wanted, number = f"/{kind}/{name}_{number}", number + 1
            self._names[kind, sensor_id] = wanted
        return self._names[kind, sensor_id]


def encode(message: Message, topics: Topics) -> RosMessages:
    """Yield ROS's messages of one of a run."""
    if isinstance(message, Mounts):
        yield MOUNTS, _transforms([_transform(message.time_ns, *row, EGO) for row in message.poses.items()])
    elif isinstance(message, BoxLabels):
        yield from _boxes(message)
    elif isinstance(message, ImageMessage):
        yield from _image(message, topics.of("camera", message.sensor_id))
    elif isinstance(message, SweepMessage):
        yield from _sweep(message, topics.of("lidar", message.sensor_id))
    elif isinstance(message, RolloutEgo):
        yield TRANSFORMS, _transforms([_transform(message.time_ns, REAR_AXLE, message.pose)])
        zeros = np.zeros(36)
        linear, angular = _vector((message.speed_m_s, 0.0, 0.0)), _vector((0.0, 0.0, message.yaw_rate_rad_s))
        twist = _of("geometry_msgs/Twist", linear=linear, angular=angular)
        yield (
            EGO_STATE,
            _of(
                "nav_msgs/Odometry",
                header=_header(message.time_ns, WORLD),
                child_frame_id=REAR_AXLE,
                pose=_of("geometry_msgs/PoseWithCovariance", pose=_pose(message.pose), covariance=zeros),
                twist=_of("geometry_msgs/TwistWithCovariance", twist=twist, covariance=zeros),
            ),
        )
    else:
        assert isinstance(message, PlannedPoses)
        poses = [
            _of("geometry_msgs/PoseStamped", header=_header(time_ns, WORLD), pose=_pose(pose))
            for time_ns, pose in zip(message.times_ns, message.poses, strict=True)
        ]
        yield EGO_PLAN, _of("nav_msgs/Path", header=_header(message.time_ns, WORLD), poses=poses)


def _boxes(message: BoxLabels) -> RosMessages:
    placed = [(EGO, message.ego), *((frame_of(box), box.pose) for box in message.boxes)]
    yield TRANSFORMS, _transforms([_transform(message.time_ns, name, pose) for name, pose in placed])
    # a box that is not named again is gone
    first = _marker(message.time_ns, "", 0, TYPES.types["visualization_msgs/msg/Marker"].DELETEALL, None)
    marks = [
        _marker(message.time_ns, box.label, number, TYPES.types["visualization_msgs/msg/Marker"].ADD, box)
        for number, box in enumerate(message.boxes)
    ]
    yield BOXES, _of("visualization_msgs/MarkerArray", markers=[first, *marks])


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


def _image(message: ImageMessage, topic: str) -> RosMessages:
    header, model, found = _header(message.time_ns, message.sensor_id), message.model, calibration_of(message.model)
    yield TRANSFORMS, _transforms([_transform(message.time_ns, *message.moved)])
    region = _of("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    yield (
        f"{topic}/camera_info",
        _of(
            "sensor_msgs/CameraInfo",
            header=header,
            height=model.height,
            width=model.width,
            distortion_model=found.distortion,
            d=np.array(found.coefficients, np.float64),
            k=np.array(found.matrix),
            r=np.eye(3).reshape(-1),
            p=np.array(found.projection),
            binning_x=0,
            binning_y=0,
            roi=region,
        ),
    )
    data = np.frombuffer(message.path.read_bytes(), np.uint8)
    yield f"{topic}/image/compressed", _of("sensor_msgs/CompressedImage", header=header, format="png", data=data)


def _sweep(message: SweepMessage, topic: str) -> RosMessages:
    yield TRANSFORMS, _transforms([_transform(message.time_ns, *message.moved)])
    kind = TYPES.types["sensor_msgs/msg/PointField"]
    numbers = {"<f4": kind.FLOAT32, "<f8": kind.FLOAT64, "<i4": kind.INT32}
    fields = [
        _of("sensor_msgs/PointField", name=name, offset=entry[1], datatype=numbers[entry[0].str], count=1)
        for name, entry in (POINT_FIELDS.fields or {}).items()
    ]
    count, step = len(message.points), POINT_FIELDS.itemsize
    yield (
        f"{topic}/points",
        _of(
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
        ),
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


def _transform(time_ns: int, child: str, pose: Pose, parent: str = WORLD) -> Any:
    moved = _of("geometry_msgs/Transform", translation=_vector(pose.position), rotation=_quaternion(pose))
    return _of("geometry_msgs/TransformStamped", header=_header(time_ns, parent), child_frame_id=child, transform=moved)


def _transforms(transforms: list[Any]) -> Any:
    return _of("tf2_msgs/TFMessage", transforms=transforms)
