"""What the pipeline says while the robot drives: in order of arrival, with what networks do."""

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS, Session, live, make_session, pushed
from support.fusion.networks import assert_same_places

from trigpoint.base.clock import to_ns
from trigpoint.contract import topics
from trigpoint.contract.correction import decode_mark
from trigpoint.contract.messages import (
    CameraInfo,
    Message,
    Odometry,
    PoseEstimate,
    Sightings,
    Transforms,
)
from trigpoint.contract.topics import Topic
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.pipeline import Output, Pipeline

Arrivals = list[tuple[int, str, Message]]
Sent = list[tuple[int, Output]]
PLANE = [0, 1, 5]


def arrivals(session: Session, *, late: frozenset[int] = frozenset()) -> Arrivals:
    """Pictures take 20 ms and now and then much longer, so that they come out of order; some
    messages come twice; those with a stamp in `late` three seconds after the others."""
    random, found = np.random.default_rng(3), []
    for node, message in session.messages:
        assert isinstance(message, Odometry | Sightings)
        delay_s = 0.002 if isinstance(message, Odometry) else 0.02 + random.exponential(0.08)
        if isinstance(message, Sightings):
            delay_s = min(delay_s, 0.9) + 3.0 * (message.stamp_ns in late)
        found.append((message.stamp_ns + to_ns(delay_s), node, message))
        if random.random() < 0.05:
            again_ns = message.stamp_ns + to_ns(delay_s + 0.1 * random.random())
            found.append((again_ns, node, message))
    return found


@pytest.fixture(scope="module")
def run(session: Session) -> tuple[Pipeline, Sent]:
    return live(session.inputs, arrivals(session))


def of(sent: Sent, topic: Topic) -> list[tuple[int, str, PoseEstimate, bytes]]:
    """(when, node, message, attachment) of what was sent on a topic."""
    found = []
    for now_ns, output in sent:
        if output.topic is topic:
            assert isinstance(output.message, PoseEstimate)
            found.append((now_ns, output.node, output.message, output.attachment))
    return found


def sigmas(session: Session, message: PoseEstimate) -> float:
    """How far from the truth, in the message's own sigmas over x, y and heading."""
    error = message.pose.difference(session.map_from_base("r1", message.stamp_ns))[PLANE]
    return float(np.sqrt(error @ np.linalg.solve(message.covariance[np.ix_(PLANE, PLANE)], error)))


def shown(session: Session, camera: str | None = None) -> list[int]:
    """Stamps of pictures that show something."""
    return [
        m.stamp_ns
        for n, m in session.messages
        if isinstance(m, Sightings) and m.faces and camera in (None, n)
    ]


def test_live_ends_where_offline_ends(
    session: Session, results: Results, run: tuple[Pipeline, Sent]
) -> None:
    found = run[0].results()
    assert found.network.map_id == results.network.map_id
    assert_same_places(found.network, results.network)


def test_messages_that_came_twice_are_counted_and_used_once(
    session: Session, run: tuple[Pipeline, Sent]
) -> None:
    twice = [m for _, _, m in arrivals(session)]
    stamps = [m.stamp_ns for m in twice if isinstance(m, Odometry)]
    assert run[0].left_out["stale_odometry"] == len(stamps) - len(set(stamps))
    assert run[0].left_out.keys() <= {"stale_odometry", "repeated"}


def test_corrections_are_honest(session: Session, run: tuple[Pipeline, Sent]) -> None:
    errors = [sigmas(session, message) for _, _, message, _ in of(run[1], topics.CORRECTION)]
    assert len(errors) > 10
    assert max(errors) < 5
    # Three degrees of freedom; neighbours share their cameras' errors, so the mean of a drive is
    # about that of a dozen independent ones: between 3/4 and 9/4 of it at five sigmas of √(2/36).
    assert 0.3 < np.mean(np.square(errors)) / 3 < 2.25


def test_correction_bears_its_sightings_stamp_the_map_and_the_next_number(
    session: Session, run: tuple[Pipeline, Sent]
) -> None:
    sent = of(run[1], topics.CORRECTION)
    marks = [decode_mark(attachment) for *_, attachment in sent]
    assert {mark.map_id for mark in marks} == {run[0].map_id}
    assert [mark.sequence for mark in marks] == list(
        range(marks[0].sequence, marks[0].sequence + len(marks))
    )
    assert {message.stamp_ns for _, _, message, _ in sent} <= set(shown(session))
    for now_ns, node, message, _ in sent:
        assert node == "r1"
        assert message.frame_id == "map"
        assert 0 < now_ns - message.stamp_ns <= to_ns(1.0)
        np.testing.assert_allclose(message.covariance[[2, 3, 4]], 0.0, atol=1e-12)
        assert np.all(np.linalg.eigvalsh(message.covariance[np.ix_(PLANE, PLANE)]) > 0)


def test_no_correction_by_a_camera_before_it_is_located_nor_by_what_locates_it(
    session: Session, run: tuple[Pipeline, Sent]
) -> None:
    """The first corrections of a camera come after its pose was said, by a later picture."""
    located_ns: dict[str, int] = {}
    for now_ns, node, _, _ in of(run[1], topics.CAMERA_POSE):
        located_ns.setdefault(node, now_ns)
    assert located_ns.keys() == session.plan.cameras.keys()
    by_stamp = {stamp: name for name in session.plan.cameras for stamp in shown(session, name)}
    for now_ns, _, message, _ in of(run[1], topics.CORRECTION):
        assert now_ns > located_ns[by_stamp[message.stamp_ns]]


def test_robot_poses_are_said_at_every_odometry_message_and_honest(
    session: Session, run: tuple[Pipeline, Sent]
) -> None:
    poses = of(run[1], topics.ROBOT_POSE)
    odometry = [m.stamp_ns for _, m in session.messages if isinstance(m, Odometry)]
    assert [message.stamp_ns for _, _, message, _ in poses] == odometry
    # The first one is exact, and its covariance next to nothing.
    assert max(sigmas(session, message) for _, _, message, _ in poses[1:]) < 5.5


def test_transforms_lead_from_the_map_to_every_frame(
    session: Session, run: tuple[Pipeline, Sent]
) -> None:
    edges: dict[str, str] = {}
    for _, output in run[1]:
        if output.topic is topics.TF:
            for transform in output.message.transforms:  # pyright: ignore[reportAttributeAccessIssue]
                edges[transform.child] = transform.parent
    cameras = {f"{name}/optical": "map" for name in session.plan.cameras}
    assert edges == cameras | {"r1/odom": "map", "r1/base": "r1/odom"}


def test_no_transform_grows_older_than_a_second_while_nobody_is_seen(charuco: Session) -> None:
    sightings = [m for _, m in charuco.messages if isinstance(m, Sightings) and m.faces]
    until_ns = sightings[len(sightings) // 2].stamp_ns
    # From the drive's middle on, no camera sees anything any more.
    come: list[tuple[int, str, Message]] = [
        (message.stamp_ns, node, message)
        for node, message in charuco.messages
        if isinstance(message, Odometry)
        or (isinstance(message, Sightings) and message.stamp_ns <= until_ns)
    ]
    _, sent = live(charuco.inputs, come)
    stamps: dict[str, list[int]] = {}
    for _, output in sent:
        if output.topic is topics.TF_STATIC and isinstance(output.message, Transforms):
            for one in output.message.transforms:
                stamps.setdefault(one.child, []).append(one.stamp_ns)
    assert stamps, "no camera was located in that time"
    end_ns = max(message.stamp_ns for _, message in charuco.messages)
    for camera, told in stamps.items():
        assert np.max(np.diff([*told, end_ns])) < to_ns(1.0), camera


def test_coverage_is_said_for_every_camera(session: Session, run: tuple[Pipeline, Sent]) -> None:
    polygons = [output for _, output in run[1] if output.topic is topics.COVERAGE]
    assert {output.node for output in polygons} == session.plan.cameras.keys()
    for output in polygons:
        points = output.message.points  # pyright: ignore[reportAttributeAccessIssue]
        assert points.shape[1] == 3
        assert np.all(np.isfinite(points))
        np.testing.assert_array_equal(points[:, 2], 0.0)


# -- too late, too often --------------------------------------------------------------------------


def test_late_sightings_make_no_correction_but_count_in_the_network(
    charuco: Session, charuco_results: Results
) -> None:
    chosen = frozenset(shown(charuco)[5::3])
    pipeline, sent = live(charuco.inputs, arrivals(charuco, late=chosen))
    assert pipeline.left_out["late"] == len(chosen)
    corrected = {message.stamp_ns for _, _, message, _ in of(sent, topics.CORRECTION)}
    assert corrected
    assert not corrected & chosen
    network = pipeline.results().network
    assert_same_places(network, charuco_results.network)
    for name, record in charuco_results.network.cameras.items():
        mine = network.cameras[name]
        assert mine.position_sigma == pytest.approx(record.position_sigma, rel=0.02)


def test_sighting_that_came_out_of_order_gives_what_it_gives_in_order(charuco: Session) -> None:
    """The last two pictures of a located camera, swapped: the robot ends at the same place."""
    until = next(
        i
        for i in range(len(charuco.messages), 0, -1)
        if isinstance(charuco.messages[i - 1][1], Sightings)
        and charuco.messages[i - 1][1].stamp_ns == shown(charuco, "c1")[14]  # pyright: ignore[reportAttributeAccessIssue]
    )
    begun = charuco.messages[:until]
    pictures = [item for item in begun if isinstance(item[1], Sightings)]
    ends = []
    for held in (0, 2):
        late = pictures[len(pictures) - held - 1 :] if held else []
        kept = [item for item in begun if not any(item is other for other in late)]
        pipeline = Pipeline(charuco.inputs)
        for node, message in (*kept, *reversed(late)):
            pipeline.push(node, message)
            pipeline.advance()
        ends.append(pipeline._estimator.robot("r1"))
    in_order, out_of_order = ends
    assert in_order is not None
    assert out_of_order is not None
    assert in_order.stamp_ns == out_of_order.stamp_ns
    sigma = np.sqrt(np.diagonal(in_order.covariance)[PLANE])
    apart = in_order.map_from_base.difference(out_of_order.map_from_base)[PLANE]
    # The same filter but for its fixed point, which a picture moves by less than a sigma.
    np.testing.assert_allclose(apart / sigma, 0.0, atol=0.1)
    spread = np.sqrt(np.diagonal(out_of_order.covariance)[PLANE])
    np.testing.assert_allclose(spread / sigma, 1.0, atol=0.05)


def test_corrections_keep_their_rate(charuco: Session) -> None:
    site = charuco.inputs.site
    slow = structs.replace(site, fusion=structs.replace(site.fusion, correction_rate=0.5))
    inputs = replace(charuco.inputs, site=slow)
    _, sent = live(inputs, arrivals(charuco))
    stamps = sorted(message.stamp_ns for _, _, message, _ in of(sent, topics.CORRECTION))
    seconds = charuco.plan.seconds
    assert 3 < len(stamps) <= 0.5 * seconds + 2


def test_nothing_is_said_offline(charuco: Session) -> None:
    pipeline = Pipeline(charuco.inputs, is_live=False)
    for node, message in charuco.messages[:200]:
        pipeline.push(node, message)
    assert not any(o.topic is topics.ROBOT_POSE for o in pipeline.advance())


def test_late_announced_lens_uses_what_was_seen_before(charuco: Session) -> None:
    inputs = replace(charuco.inputs, lenses={})
    infos = [
        (n, CameraInfo(EPOCH_NS, f"{n}/optical", c.lens)) for n, c in charuco.plan.cameras.items()
    ]
    pipeline = pushed(inputs, (*charuco.messages[:100], *infos, *charuco.messages[100:]))
    assert pipeline.results().network.located == ["c1", "c2", "c3"]
    assert pipeline.left_out == {}


def test_identity_of_the_map_is_that_of_site_robot_and_first_message(charuco: Session) -> None:
    pipeline = Pipeline(charuco.inputs)
    assert pipeline.map_id is None
    pipeline.push(*charuco.messages[0])
    first = pipeline.map_id
    assert first == pushed(charuco.inputs, charuco.messages[:50]).map_id
    other = make_session(replace(charuco.plan, seconds=0.1))
    later = replace(other.messages[0][1], stamp_ns=EPOCH_NS + 1)  # pyright: ignore[reportCallIssue]
    moved = Pipeline(charuco.inputs)
    moved.push("r1", later)
    assert moved.map_id != first
