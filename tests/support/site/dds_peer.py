"""A DDS participant that speaks nav_msgs/msg/Odometry as a ROS 2 node does (CycloneDDS)."""

from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from trigpoint.contract.messages import Odometry


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Triple(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class RosPose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Triple
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: RosPose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Triple
    angular: Triple


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class RosOdometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


class DdsOdometry:
    """A writer and a reader of one topic, as two nodes have them."""

    def __init__(self, *, domain: int) -> None:
        qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
        self._participants = [DomainParticipant(domain) for _ in range(2)]
        topics = [Topic(each, "rt/odom", RosOdometry) for each in self._participants]
        self._writer = DataWriter(self._participants[0], topics[0], qos=qos)
        self._reader = DataReader(self._participants[1], topics[1], qos=qos)

    def sent(self, message: Odometry) -> bytes:
        """The CDR of a message that went over DDS."""
        seconds, nanoseconds = divmod(message.stamp_ns, 10**9)
        x, y, z = (float(value) for value in message.pose.translation)
        orientation = Quaternion(*(float(value) for value in message.pose.quaternion))
        zero = Triple(0.0, 0.0, 0.0)
        unknown: Any = [0.0] * 36  # what cyclonedds calls an array is any sequence
        self._writer.write(
            RosOdometry(
                Header(Time(seconds, nanoseconds), message.frame_id),
                message.child_frame_id,
                PoseWithCovariance(RosPose(Triple(x, y, z), orientation), unknown),
                TwistWithCovariance(Twist(zero, zero), unknown),
            )
        )
        for sample in self._reader.take_iter(timeout=duration(seconds=5)):
            return bytes(sample.serialize())
        raise AssertionError("nothing came over DDS in five seconds")

    def decoded(self, payload: bytes) -> Any:
        """What DDS reads out of our bytes."""
        return RosOdometry.deserialize(payload)

    def close(self) -> None:
        del self._reader, self._writer
        self._participants.clear()
