"""A session's messages: odometry is read as runs, with what comes of reading each by itself."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import (
    Session,
    lab_cameras,
    lab_plan,
    make_session,
    two_robots,
    write_session,
)

from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import CameraInfo, Mended, Message, Odometry, Sightings
from trigpoint.fusion.model.readings import Readings
from trigpoint.geometry import Pose
from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.sessions import messages as recorded
from trigpoint.tools.sessions.messages import SessionMessages, messages_of


@pytest.fixture(scope="module")
def two() -> Session:
    """Two robots, whose odometry has the same stamps."""
    return make_session(lab_plan(cameras=lab_cameras(2), robots=two_robots(), seconds=3.0))


def flat(found: SessionMessages) -> list[tuple[str, str, int, bytes]]:
    """Of each message in order: whose it is, its kind, its stamp, and an odometry's pose."""
    rows = list[tuple[str, str, int, bytes]]()
    for node, message in found.in_order:
        if isinstance(message, Readings):
            poses, stamps_ns = message.odom_from_base.rows(), message.stamps_ns.tolist()
            each = zip(stamps_ns, poses, strict=True)
            rows += [(node, Odometry.__name__, stamp, pose.tobytes()) for stamp, pose in each]
        else:
            pose = message.pose.rows().tobytes() if isinstance(message, Odometry) else b""
            stamp_ns = message.stamp_ns if isinstance(message, Odometry | Sightings) else 0
            rows.append((node, type(message).__name__, stamp_ns, pose))
    return rows


def one_by_one(folder: Path) -> SessionMessages:
    found = SessionMessages()
    for order, sample in enumerate(open_recording(folder).samples()):
        message = cdr.decode(sample.topic.type_name, sample.payload)
        found.add(topics.node_of(sample.key), message, sample.log_ns, order=order)
    return found


def kinds(found: SessionMessages) -> list[type[Message | Readings]]:
    return [type(message) for _, message in found.in_order]


def test_odometry_of_several_robots_is_in_order(two: Session, tmp_path: Path) -> None:
    folder = write_session(two, tmp_path)
    found, expected = messages_of(open_recording(folder)), one_by_one(folder)
    assert flat(found) == flat(expected)
    assert found.count == expected.count
    assert found.robots == expected.robots == {"r1", "r2"}
    assert Odometry not in kinds(found)
    assert kinds(found)[0] is CameraInfo


def test_odometry_without_a_stamp_is_mended_beside_another_robots_run(
    two: Session, tmp_path: Path
) -> None:
    at = next(i for i, (node, m) in enumerate(two.messages) if node == "r2" and i > 20)
    messages = list(two.messages)
    messages[at] = "r2", replace(messages[at][1], stamp_ns=0)
    folder = write_session(replace(two, messages=tuple(messages)), tmp_path)
    found = messages_of(open_recording(folder))
    assert flat(found) == flat(one_by_one(folder))
    mended = [
        (node, m.mended) for node, m in found.in_order if isinstance(m, Odometry) and m.mended
    ]
    assert mended == [("r2", (Mended.UNSTAMPED,))]
    assert {node for node, m in found.in_order if isinstance(m, Readings)} == {"r1"}


def test_a_message_that_is_no_run_keeps_only_its_block_from_being_one(
    two: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorded, "_BLOCK", 7)
    own = [i for i, (node, m) in enumerate(two.messages) if node == "r2" and is_odometry(m)]
    messages = list(two.messages)
    for at, change in ((own[9], {"stamp_ns": 0}), (own[24], {"frame_id": "another"})):
        messages[at] = "r2", replace(messages[at][1], **change)
    folder = write_session(replace(two, messages=tuple(messages)), tmp_path)
    found, expected = messages_of(open_recording(folder)), one_by_one(folder)
    assert flat(found) == flat(expected)
    assert found.count == expected.count
    assert sum(is_odometry(m) for _, m in found.in_order) == 2 * 7


def test_a_run_has_as_many_orders_as_messages() -> None:
    readings = Readings(np.array([1, 2]), Pose.identity().repeated(2))
    with pytest.raises(ValueError, match="shorter"):
        SessionMessages().add_run("r1", readings, orders=[0], logs_ns=[0, 0])


def is_odometry(message: Message | Readings) -> bool:
    return isinstance(message, Odometry)
