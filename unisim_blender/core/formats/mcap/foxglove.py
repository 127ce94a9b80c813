"""Messages of a run as Foxglove's, with their topics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose as FoxglovePose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from ..common.calibration import FISHEYE, calibration_of
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

TRANSFORMS, MOUNTS, BOXES, EGO_STATE, EGO_PLAN = "/tf", "/tf_static", "/boxes", "/ego/state", "/ego/plan"
NUMBERS = {"<f4": PackedElementField.FLOAT32, "<f8": PackedElementField.FLOAT64, "<i4": PackedElementField.INT32}

FoxgloveMessages = Iterator[tuple[str, Any]]
"""Topics, and messages of protobuf."""


def encode(message: Message) -> FoxgloveMessages:
    """Yield Foxglove's messages of one of a run."""
    stamp = Timestamp()
    stamp.FromNanoseconds(message.time_ns)
    if isinstance(message, Mounts):
        mounts = [_transform(stamp, name, pose, EGO) for name, pose in message.poses.items()]
        yield MOUNTS, FrameTransforms(transforms=mounts)
    elif isinstance(message, BoxLabels):
        yield from _boxes(message, stamp)
    elif isinstance(message, ImageMessage):
        yield from _image(message, stamp)
    elif isinstance(message, SweepMessage):
        yield from _sweep(message, stamp)
    elif isinstance(message, RolloutEgo):
        yield TRANSFORMS, FrameTransforms(transforms=[_transform(stamp, REAR_AXLE, message.pose)])
        numbers = {"acceleration_m_s2": message.acceleration_m_s2, "steering_rad": message.steering_rad}
        yield (
            EGO_STATE,
            Odometry(
                timestamp=stamp,
                frame_id=WORLD,
                body_frame_id=REAR_AXLE,
                pose=_pose(message.pose),
                linear_velocity=Vector3(x=message.speed_m_s, y=0.0, z=0.0),
                angular_velocity=Vector3(x=0.0, y=0.0, z=message.yaw_rate_rad_s),
                metadata=_pairs({name: repr(value) for name, value in numbers.items()}),
            ),
        )
    else:
        assert isinstance(message, PlannedPoses)
        yield EGO_PLAN, PosesInFrame(timestamp=stamp, frame_id=WORLD, poses=[_pose(one) for one in message.poses])


def _boxes(message: BoxLabels, stamp: Timestamp) -> FoxgloveMessages:
    placed = [(EGO, message.ego), *((frame_of(box), box.pose) for box in message.boxes)]
    yield TRANSFORMS, FrameTransforms(transforms=[_transform(stamp, name, pose) for name, pose in placed])
    # a box that is not named again is gone
    deletion = SceneEntityDeletion(timestamp=stamp, type=SceneEntityDeletion.ALL)
    yield BOXES, SceneUpdate(deletions=[deletion], entities=[_entity(box, stamp) for box in message.boxes])


def _entity(box: LabelledBox, stamp: Timestamp) -> SceneEntity:
    x, y, z = box.size_m
    r, g, b, a = colour_of(box)
    cube = CubePrimitive(pose=_pose(box.pose), size=Vector3(x=x, y=y, z=z), color=Color(r=r, g=g, b=b, a=a))
    return SceneEntity(timestamp=stamp, frame_id=WORLD, id=box.uid, metadata=_pairs(box.notes), cubes=[cube])


def _image(message: ImageMessage, stamp: Timestamp) -> FoxgloveMessages:
    name, model, found = message.sensor_id, message.model, calibration_of(message.model)
    yield TRANSFORMS, FrameTransforms(transforms=[_transform(stamp, *message.moved)])
    yield (
        f"/camera/{name}/calibration",
        CameraCalibration(
            timestamp=stamp,
            frame_id=name,
            width=model.width,
            height=model.height,
            distortion_model="kannala_brandt" if found.distortion == FISHEYE else found.distortion,
            D=found.coefficients,
            K=found.matrix,
            R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            P=found.projection,
        ),
    )
    data = message.path.read_bytes()
    yield f"/camera/{name}/image", CompressedImage(timestamp=stamp, frame_id=name, data=data, format="png")


def _sweep(message: SweepMessage, stamp: Timestamp) -> FoxgloveMessages:
    name = message.sensor_id
    yield TRANSFORMS, FrameTransforms(transforms=[_transform(stamp, *message.moved)])
    fields = [
        PackedElementField(name=field, offset=offset, type=NUMBERS[kind.str])
        for field, (kind, offset) in _layout().items()
    ]
    yield (
        f"/lidar/{name}/points",
        PointCloud(
            timestamp=stamp,
            frame_id=name,
            pose=FoxglovePose(position=Vector3(x=0, y=0, z=0), orientation=Quaternion(x=0, y=0, z=0, w=1)),
            point_stride=POINT_FIELDS.itemsize,
            fields=fields,
            data=message.points.tobytes(),
        ),
    )


def _layout() -> Mapping[str, Any]:
    return {name: entry[:2] for name, entry in (POINT_FIELDS.fields or {}).items()}


def _transform(stamp: Timestamp, child: str, pose: Pose, parent: str = WORLD) -> FrameTransform:
    found = _pose(pose)
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=found.position,
        rotation=found.orientation,
    )


def _pose(pose: Pose) -> FoxglovePose:
    x, y, z = pose.position
    qw, qx, qy, qz = pose.quaternion_wxyz
    return FoxglovePose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _pairs(notes: Mapping[str, str]) -> list[KeyValuePair]:
    return [KeyValuePair(key=key, value=value) for key, value in notes.items()]
