"""When a robot was lifted, by pictures of cameras whose clocks are not known."""

import numpy as np
from msgspec.structs import replace
from support.fusion.drives import (
    EPOCH_NS,
    STEP_S,
    CameraPlan,
    Plan,
    RobotPlan,
    Sent,
    Session,
    circle,
    lens,
    make_session,
    observed,
)

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Odometry
from trigpoint.fusion.association.engine import explain
from trigpoint.geometry import Pose
from trigpoint.testing.views import looking_at
from trigpoint.tools.simulation.sight.targets import target_of

OFFSETS_S = (-0.06, 0.06, 0.0)
# The cameras take turns at every step: the first sees the robot last before it is lifted.
LIFTED_S = 6.0125


def watched(*, map_from_odom: Pose) -> Session:
    """A robot that three cameras see all the time, each with a clock that is off."""
    cameras = {}
    for number, offset_s in enumerate(OFFSETS_S):
        angle = 2 * np.pi * number / 3
        eye = 2.6 * np.cos(angle), 1.2 + 2.6 * np.sin(angle), 1.8
        more = "time_offset_sigma = 0.05"
        pose = looking_at(eye, (0, 1.2, 0.65))
        cameras[f"c{number + 1}"] = CameraPlan(pose, lens(70.0), None, offset_s, more)
    robot = RobotPlan(circle(), target_of("charuco"), map_from_odom=map_from_odom)
    return make_session(Plan(cameras, {"r1": robot}, seconds=12.0, picture_rate=10.0))


def taken_ns(name: str, message: Sent) -> int:
    """When a picture was taken."""
    return message.stamp_ns - to_ns(OFFSETS_S[int(name[1:]) - 1])


def test_lift_is_between_the_pictures_beside_it_by_the_clocks_of_their_cameras() -> None:
    here = watched(map_from_odom=Pose.identity())
    there = watched(map_from_odom=Pose.planar(0.5, 0.3, 0.4))
    lifted_ns = EPOCH_NS + to_ns(LIFTED_S)
    sent = [
        (name, message)
        for session, is_after in ((here, False), (there, True))
        for name, message in session.messages
        if (isinstance(message, Odometry) and not is_after)
        or (not isinstance(message, Odometry) and (taken_ns(name, message) > lifted_ns) == is_after)
    ]
    sent.sort(key=lambda each: each[1].stamp_ns)
    data = observed(replace(here, messages=tuple(sent)))
    ((lift,),) = explain(data, [entry.observation for entry in data.entries]).lifts
    assert lift.after_ns < lifted_ns < lift.before_ns
    assert lift.before_ns - lift.after_ns < 2 * to_ns(STEP_S)
