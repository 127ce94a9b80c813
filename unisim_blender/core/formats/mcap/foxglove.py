"""Messages of a run as Foxglove's, with their topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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

from ..common.messages import (
    FISHEYE,
    POINT_FIELDS,
    REAR_AXLE,
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

NUMBERS = {"<f4": PackedElementField.FLOAT32, "<f8": PackedElementField.FLOAT64, "<i4": PackedElementField.INT32}


class FoxgloveEncoder(MessageEncoder):
    """Messages of protobuf."""

    camera_info, image = "calibration", "image"

    def transforms(self, time_ns: int, poses: Mapping[str, Pose], parent: str = WORLD) -> FrameTransforms:
        stamp = _stamp(time_ns)
        return FrameTransforms(transforms=[_transform(stamp, name, pose, parent) for name, pose in poses.items()])

    def boxes(self, time_ns: int, boxes: Sequence[LabelledBox]) -> SceneUpdate:
        stamp = _stamp(time_ns)
        deletion = SceneEntityDeletion(timestamp=stamp, type=SceneEntityDeletion.ALL)
        return SceneUpdate(deletions=[deletion], entities=[_entity(box, stamp) for box in boxes])

    def calibration(self, message: ImageMessage, calibration: OpenCVCalibration) -> CameraCalibration:
        return CameraCalibration(
            timestamp=_stamp(message.time_ns),
            frame_id=message.sensor_id,
            width=message.model.width,
            height=message.model.height,
            distortion_model="kannala_brandt" if calibration.distortion == FISHEYE else calibration.distortion,
            D=calibration.coefficients,
            K=calibration.matrix,
            R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
            P=calibration.projection,
        )

    def compressed_image(self, message: ImageMessage) -> CompressedImage:
        data, stamp = message.path.read_bytes(), _stamp(message.time_ns)
        return CompressedImage(timestamp=stamp, frame_id=message.sensor_id, data=data, format="png")

    def point_cloud(self, message: SweepMessage) -> PointCloud:
        return PointCloud(
            timestamp=_stamp(message.time_ns),
            frame_id=message.sensor_id,
            pose=FoxglovePose(position=Vector3(x=0, y=0, z=0), orientation=Quaternion(x=0, y=0, z=0, w=1)),
            point_stride=POINT_FIELDS.itemsize,
            fields=[
                PackedElementField(name=name, offset=offset, type=NUMBERS[kind])
                for name, kind, offset in point_layout()
            ],
            data=message.points.tobytes(),
        )

    def odometry(self, message: RolloutEgo) -> Odometry:
        numbers = {"acceleration_m_s2": message.acceleration_m_s2, "steering_rad": message.steering_rad}
        return Odometry(
            timestamp=_stamp(message.time_ns),
            frame_id=WORLD,
            body_frame_id=REAR_AXLE,
            pose=_pose(message.pose),
            linear_velocity=Vector3(x=message.speed_m_s, y=0.0, z=0.0),
            angular_velocity=Vector3(x=0.0, y=0.0, z=message.yaw_rate_rad_s),
            metadata=_pairs({name: repr(value) for name, value in numbers.items()}),
        )

    def path(self, message: PlannedPoses) -> PosesInFrame:
        poses = [_pose(pose) for pose in message.poses]
        return PosesInFrame(timestamp=_stamp(message.time_ns), frame_id=WORLD, poses=poses)


def _stamp(time_ns: int) -> Timestamp:
    stamp = Timestamp()
    stamp.FromNanoseconds(time_ns)
    return stamp


def _entity(box: LabelledBox, stamp: Timestamp) -> SceneEntity:
    x, y, z = box.size_m
    r, g, b, a = colour_of(box)
    cube = CubePrimitive(pose=_pose(box.pose), size=Vector3(x=x, y=y, z=z), color=Color(r=r, g=g, b=b, a=a))
    return SceneEntity(timestamp=stamp, frame_id=WORLD, id=box.uid, metadata=_pairs(box.notes), cubes=[cube])


def _transform(stamp: Timestamp, child: str, pose: Pose, parent: str) -> FrameTransform:
    placed = _pose(pose)
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=placed.position,
        rotation=placed.orientation,
    )


def _pose(pose: Pose) -> FoxglovePose:
    x, y, z = pose.position
    qw, qx, qy, qz = pose.quaternion_wxyz
    return FoxglovePose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def _pairs(notes: Mapping[str, str]) -> list[KeyValuePair]:
    return [KeyValuePair(key=key, value=value) for key, value in notes.items()]
