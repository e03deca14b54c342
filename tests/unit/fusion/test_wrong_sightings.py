"""Sightings and odometry that are wrong are set aside, counted, and ruin nothing."""

from collections.abc import Iterator

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS, Session, offline, pushed
from support.fusion.honesty import Messages, assert_honest, assert_sound, changed, statuses

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import Message, Odometry, Sightings
from trigpoint.geometry import Pose


def disturbed(messages: Messages, change) -> Messages:
    """Messages with every picture's faces changed: `change` gets a random number and the faces."""
    random = np.random.default_rng(11)
    return tuple(
        (n, replace(m, faces=change(random, m.faces)) if isinstance(m, Sightings) else m)
        for n, m in messages
    )


def assert_rejected(session: Session, change, spoiled: list[int], *, least: int) -> None:
    """What `change` spoils, and counts in `spoiled`, is set aside, no more, and ruins nothing."""
    session = changed(session, messages=disturbed(session.messages, change))
    results = offline(session)
    assert_honest(session, results)
    assert len(spoiled) >= least
    assert sum(c.rejected for c in results.network.cameras.values()) == len(spoiled)


def test_displaced_pictures_are_rejected_and_counted(charuco: Session) -> None:
    moved: list[int] = []

    def displace(random: np.random.Generator, faces):
        if not faces or random.random() > 0.07:
            return faces
        angle = random.uniform(0, 2 * np.pi)
        moved.extend([1] * len(faces))
        shift = np.float32(15) * np.array([np.cos(angle), np.sin(angle)], np.float32)
        return tuple(replace(face, pixels=face.pixels + shift) for face in faces)

    assert_rejected(charuco, displace, moved, least=3)


def test_a_displaced_face_costs_the_other_face_of_its_picture_nothing(charuco: Session) -> None:
    moved: list[int] = []

    def displace(random: np.random.Generator, faces):
        if len(faces) < 2 or random.random() > 0.15:
            return faces
        moved.append(1)
        first = replace(faces[0], pixels=faces[0].pixels + np.array([0, 15], np.float32))
        return (first, *faces[1:])

    assert_rejected(charuco, displace, moved, least=3)


def test_single_wild_corners_cost_no_picture(charuco: Session) -> None:
    def scatter(random: np.random.Generator, faces):
        found = []
        for face in faces:
            pixels = face.pixels.copy()
            if random.random() < 0.3:
                pixels[random.integers(len(pixels))] += random.normal(0, 20, 2)
            found.append(replace(face, pixels=pixels))
        return tuple(found)

    wild = changed(charuco, messages=disturbed(charuco.messages, scatter))
    results = offline(wild)
    assert_honest(wild, results)
    assert sum(c.rejected for c in results.network.cameras.values()) == 0
    for camera in results.network.cameras.values():
        assert camera.reprojection_rms == pytest.approx(charuco.plan.sigma, rel=0.15)


def test_face_that_is_named_wrongly_is_rejected(charuco: Session) -> None:
    wrong: list[int] = []

    def misname(random: np.random.Generator, faces):
        if len(faces) != 1 or random.random() > 0.2:
            return faces
        wrong.append(1)
        return (replace(faces[0], face=(faces[0].face + 2) % 6),)

    assert_rejected(charuco, misname, wrong, least=1)


def lifted(session: Session, at_s: float) -> Session:
    """The robot's counters start anew at a moment, somewhere else."""
    jump = Pose.planar(2.0, -1.0, 2.5)
    stamp_ns = EPOCH_NS + to_ns(at_s)

    def moved() -> Iterator[tuple[str, Message]]:
        for node, m in session.messages:
            is_after = isinstance(m, Odometry) and m.stamp_ns > stamp_ns
            yield node, (replace(m, pose=jump @ m.pose) if is_after else m)  # pyright: ignore[reportCallIssue, reportAttributeAccessIssue]

    return replace(session, messages=tuple(moved()))


def test_jump_of_the_odometry_does_not_ruin_the_map(charuco: Session) -> None:
    session = lifted(charuco, 20.0)  # c1 sees it again afterwards
    pipeline = pushed(session.inputs, session.messages)
    assert pipeline.left_out["odometry_jumps"] == 1
    results = pipeline.results()
    assert_honest(session, results)
    _, poses = results.trajectories["r1"]
    assert np.abs(poses[-1].difference(session.truth["r1"][-1])).max() < 0.05


def test_camera_behind_a_jump_is_undetermined_and_no_place_is_made_up(charuco: Session) -> None:
    """c1 before the jump, c2 after it, and nothing that ties the two."""
    session, cut_ns = lifted(charuco, 7.0), EPOCH_NS + to_ns(7.0)
    kept = tuple(
        (n, m)
        for n, m in session.messages
        if isinstance(m, Odometry) or n == ("c1" if m.stamp_ns < cut_ns else "c2")
    )
    results = offline(replace(session, messages=kept))
    record = results.network.cameras["c2"]
    assert statuses(results) == {"c1": "located", "c2": "undetermined", "c3": "unseen"}
    assert "odometry jumped" in record.undetermined[0]
    assert (record.map_from_camera, record.covariance) == (None, None)
    assert_sound(results)
