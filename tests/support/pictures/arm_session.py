"""The pictures of `charuco-arm` as a session: the arm's poses as odometry, the board on its wrist
as the target, one static camera.

A folder with session.mcap, site.toml and target.toml, for `trigpoint calibrate`:

    python tests/support/pictures/arm_session.py FOLDER && trigpoint calibrate FOLDER
"""

import json
import math
import sys
from pathlib import Path

import numpy as np
from support.builders import REAL_DATA

from trigpoint.base.clock import to_ns
from trigpoint.contract import cdr
from trigpoint.contract.messages import CameraInfo, Odometry, Sightings
from trigpoint.edge.detector import TargetDetector, detector_for
from trigpoint.edge.sources.picture_files import read_picture
from trigpoint.fusion.inbox import INPUT_TOPICS
from trigpoint.geometry import CameraModel, Pose
from trigpoint.geometry import rotation as so3
from trigpoint.recorder.mcap.writer import McapWriter
from trigpoint.site.target import parse_target

ARM = REAL_DATA / "charuco-arm"
EPOCH_NS = 1_700_000_000_000_000_000
PERIOD_NS = to_ns(1.0)
# As published with the pictures, without distortion.
LENS = CameraModel(1600, 1200, 1352.03, 1356.14, 789.67, 627.30)

# What one move of the arm is uncertain by.
MOVE_M = 0.001
MOVE_RAD = math.radians(0.1)

TARGET = """
name = "arm"
[[faces]]
id = 0
pattern = "charuco"
columns = 5
rows = 7
square = 0.036195
marker = 0.018256
dictionary = "DICT_6X6_250"
translation = {translation}
quaternion = {quaternion}
"""
SITE = """
site = "arm"
target = "target.toml"
[cameras.c1]
source = "dir://none"
width = 1600
height = 1200
[robots.r1]
port = "loop://"
planar = false
[robots.r1.odometry]
distance = {per_root_m!r}
lateral = {per_root_m!r}
vertical = {per_root_m!r}
heading_drive = 0.0
tilt_turn = {per_root_rad!r}
heading_turn = {per_root_rad!r}
[fusion]
target_translation = 0.05
target_rotation = 0.2
"""
# wrist_from_board to a centimetre and five degrees, from a hand-eye solution of these pictures.
ABOUT = Pose(
    so3.exp([math.radians(95.0), 0.0, 0.0])
    @ so3.exp([0.0, math.radians(45.0), 0.0])
    @ so3.exp([0.0, 0.0, math.radians(-95.0)]),
    np.array([-0.10, -0.04, 0.16]),
)


def arm_poses() -> list[tuple[Path, Pose]]:
    """Each picture with base_from_wrist."""
    table = json.loads((ARM / "base_from_wrist.json").read_text())
    return [
        (ARM / name, Pose.from_quaternion(row["translation"], row["quaternion"]))
        for name, row in sorted(table.items())
    ]


def site_text(poses: list[Pose]) -> str:
    """The site file: the noise of a mean move is that of every move."""
    every = Pose.stack(poses)
    steps = every[:-1].inverse() @ every[1:]
    length = np.linalg.norm(steps.translation, axis=1).mean()
    turned = np.linalg.norm(so3.log(steps.rotation), axis=1).mean()
    return SITE.format(
        per_root_m=float(MOVE_M / math.sqrt(length)),
        per_root_rad=float(MOVE_RAD / math.sqrt(turned)),
    )


def target_text() -> str:
    translation, quaternion = ABOUT.translation.tolist(), ABOUT.quaternion.tolist()
    return TARGET.format(translation=translation, quaternion=quaternion)


def sightings(picture: Path, stamp_ns: int, detector: TargetDetector) -> Sightings:
    faces = detector.detect(read_picture(picture))
    return Sightings(stamp_ns, "c1/optical", LENS.width, LENS.height, faces)


def write_arm_session(folder: Path) -> Path:
    """Write the session; returns its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures = arm_poses()
    files = {"site.toml": site_text([pose for _, pose in pictures]), "target.toml": target_text()}
    detector = detector_for([parse_target(files["target.toml"])])
    writer = McapWriter(folder / "session.mcap")
    for name, text in files.items():
        (folder / name).write_text(text)
        writer.attach(name, text.encode(), "application/toml", time_ns=EPOCH_NS)
    messages: list[tuple[str, CameraInfo | Odometry | Sightings]] = [
        ("c1", CameraInfo(EPOCH_NS, "c1/optical", LENS))
    ]
    for number, (picture, pose) in enumerate(pictures):
        stamp_ns = EPOCH_NS + number * PERIOD_NS
        messages.append(("r1", Odometry(stamp_ns, "r1/odom", "r1/base", pose)))
        messages.append(("c1", sightings(picture, stamp_ns, detector)))
    for node, message in messages:
        topic, stamp_ns = INPUT_TOPICS[type(message)], message.stamp_ns
        key = topic.key("arm", node)
        writer.add(topic, key, cdr.encode(message), log_ns=stamp_ns, published_ns=stamp_ns)
    writer.finish()
    return folder


if __name__ == "__main__":
    write_arm_session(Path(sys.argv[1]))
