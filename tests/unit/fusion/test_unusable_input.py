"""What does not fit is counted and named, and leaves the rest as it is."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import EPOCH_NS, Session, pushed

from trigpoint.base.clock import ManualClock, to_ns
from trigpoint.contract.messages import Message, Odometry, Sightings
from trigpoint.fusion.diagnostics import Diagnostics
from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.intake.admission import Admission
from trigpoint.fusion.pipeline import Pipeline
from trigpoint.node.health import Health


def first_picture(session: Session, camera: str = "c1") -> Sightings:
    return next(
        m for n, m in session.messages if n == camera and isinstance(m, Sightings) and m.faces
    )


def odometry_until(session: Session, seconds: float) -> tuple[tuple[str, Message], ...]:
    end_ns = EPOCH_NS + to_ns(seconds)
    return tuple(
        (n, m) for n, m in session.messages if isinstance(m, Odometry) and m.stamp_ns <= end_ns
    )


def live(session: Session) -> Pipeline:
    """A pipeline that has two seconds of odometry."""
    pipeline = Pipeline(session.inputs)
    for node, message in odometry_until(session, 2.0):
        pipeline.push(node, message)
    return pipeline


def test_picture_of_another_size_is_counted_and_named(charuco: Session) -> None:
    picture = replace(first_picture(charuco), width=1280, height=720)
    pipeline = pushed(charuco.inputs, (*odometry_until(charuco, 2.0), ("c1", picture)))
    assert pipeline.left_out == {"wrong_size": 1}
    assert "camera c1" in pipeline.last_problem
    assert "1280 × 720" in pipeline.last_problem
    assert "640 × 480" in pipeline.last_problem


@pytest.mark.parametrize(
    ("change", "reason", "named"),
    [
        ({"target": "stranger"}, "unknown_target", "stranger"),
        ({"face": 17}, "unknown_face", "17"),
        ({"corners": np.array([200], np.uint16)}, "unknown_face", "face"),
        ({"face": -1}, "unknown_face", "face -1"),
    ],
    ids=["target of nobody", "face of nobody", "corner of nobody", "no face where all differ"],
)
def test_face_that_no_robot_carries_is_counted_and_named(
    charuco: Session, change: dict[str, object], reason: str, named: str
) -> None:
    picture = first_picture(charuco)
    face = replace(picture.faces[0], **change)  # pyright: ignore[reportArgumentType]
    if "corners" in change:
        face = replace(face, pixels=face.pixels[:1])
    sightings = replace(picture, faces=(face,))
    pipeline = pushed(charuco.inputs, (*odometry_until(charuco, 2.0), ("c1", sightings)))
    assert pipeline.left_out == {reason: 1}
    assert named in pipeline.last_problem
    assert "camera c1" in pipeline.last_problem


def test_message_of_nobody_in_the_site_is_counted(charuco: Session) -> None:
    picture = first_picture(charuco)
    odometry = odometry_until(charuco, 2.0)
    pipeline = pushed(charuco.inputs, (*odometry, ("c9", picture), ("r9", odometry[0][1])))
    assert pipeline.left_out == {"unknown_sender": 2}


def test_sightings_from_before_the_odometry_are_counted(charuco: Session) -> None:
    picture = replace(first_picture(charuco), stamp_ns=EPOCH_NS - to_ns(5.0))
    pipeline = pushed(charuco.inputs, (("c1", picture), *odometry_until(charuco, 2.0)))
    assert pipeline.left_out == {"before_odometry": 1}
    assert pipeline.results().network.cameras["c1"].status == "unseen"


def test_sightings_wait_for_their_odometry(charuco: Session) -> None:
    picture, odometry = first_picture(charuco), odometry_until(charuco, 2.0)
    pipeline = Pipeline(charuco.inputs)
    pipeline.push(*odometry[0])
    pipeline.push("c1", picture)
    pipeline.advance()
    assert pipeline.waiting == 1
    for node, message in odometry[1:]:
        pipeline.push(node, message)
    pipeline.advance()
    assert pipeline.waiting == 0
    assert pipeline.left_out == {}


def test_camera_with_a_clock_far_ahead_is_named_and_bounded(charuco: Session) -> None:
    pictures = [
        ("c2", replace(first_picture(charuco), stamp_ns=EPOCH_NS + to_ns(3600 + 0.2 * i)))
        for i in range(200)
    ]
    pipeline = Pipeline(charuco.inputs)
    for node, message in (*pictures, *odometry_until(charuco, 2.0)):
        pipeline.push(node, message)
        pipeline.advance()
    assert pipeline.left_out["far_ahead"] == 200
    assert pipeline.waiting == 0
    assert "camera c2 is 3600 s ahead" in pipeline.last_problem
    assert "synchronise" in pipeline.last_problem


def test_robot_without_odometry_holds_a_bounded_number_of_sightings(charuco: Session) -> None:
    picture, pipeline = first_picture(charuco), Pipeline(charuco.inputs)
    for index in range(4200):
        pipeline.push("c1", replace(picture, stamp_ns=EPOCH_NS + index * 1000))
    assert pipeline.waiting == 4096
    assert pipeline.left_out["without_odometry"] == 4200 - 4096
    assert "no odometry of r1" in pipeline.last_problem


def test_wrong_pictures_leave_the_rest_as_it_is(charuco: Session, charuco_results: Results) -> None:
    picture = first_picture(charuco)
    strange = [
        ("c1", replace(picture, stamp_ns=picture.stamp_ns + 1, width=9)),
        ("c2", replace(picture, stamp_ns=EPOCH_NS - 1)),
        ("c3", replace(picture, faces=(replace(picture.faces[0], target="x"),))),
        ("c3", replace(picture, faces=())),
        ("c7", picture),
    ]
    pipeline = pushed(charuco.inputs, (*strange, *charuco.messages))
    found = pipeline.results()
    for name, record in charuco_results.network.cameras.items():
        assert found.network.cameras[name].map_from_camera == record.map_from_camera


def test_live_two_clocks_are_said_for_as_long_as_the_camera_sees_the_target(
    charuco: Session,
) -> None:
    pipeline, site = live(charuco), charuco.inputs.site
    diagnostics, picture = Diagnostics(site, Admission(site)), first_picture(charuco)
    troubles: dict[str, str] = {}
    for second in range(10):
        stamp_ns = EPOCH_NS - to_ns(3600.0 - second)
        pipeline.push("c1", replace(picture, stamp_ns=stamp_ns))
        troubles = diagnostics.now(pipeline, to_ns(second))
    assert "camera c1: it saw a target in 10 pictures" in troubles["apart c1"]
    assert "synchronise the clocks" in troubles["apart c1"]
    assert "apart c1" not in diagnostics.now(pipeline, to_ns(20.0))


def test_each_camera_of_a_problem_is_named(charuco: Session) -> None:
    pipeline, site = live(charuco), charuco.inputs.site
    diagnostics, picture = Diagnostics(site, Admission(site)), first_picture(charuco)
    for camera in ("c1", "c2"):
        pipeline.push(camera, replace(picture, width=9))
    troubles = " ".join(diagnostics.now(pipeline, to_ns(1.0)).values())
    assert "camera c1 sends pictures of 9" in troubles
    assert "camera c2 sends pictures of 9" in troubles


def test_sightings_that_waited_are_no_clock_that_is_off_but_lasting_ones_are(
    charuco: Session,
) -> None:
    pipeline, site = live(charuco), charuco.inputs.site
    diagnostics, picture = Diagnostics(site, Admission(site)), first_picture(charuco)
    health = Health(ManualClock())

    def told(second: int, *, is_late: bool) -> str:
        if is_late:
            stamp_ns = EPOCH_NS + to_ns(1.0) + second
            pipeline.push("c1", replace(picture, stamp_ns=stamp_ns))
        pipeline.advance(EPOCH_NS + to_ns(60.0))
        diagnostics.report(pipeline, health, to_ns(second), checkpoint="")
        return health.report().message

    assert [told(second, is_late=second == 1) for second in range(1, 9)] == ["running"] * 8
    assert pipeline.left_out["late"] == 1
    lasting = [told(second, is_late=True) for second in range(400, 406)]
    assert "sightings of c1 come over 1 s late" in lasting[-1]
    assert lasting[1] == "running"
    assert told(420, is_late=False) == "running"
    # The robot passes again.
    assert "sightings of c1 come over 1 s late" in told(450, is_late=True)


def test_clock_of_its_own_that_was_set_is_said_by_fusion(charuco: Session) -> None:
    pipeline, site = live(charuco), charuco.inputs.site
    diagnostics = Diagnostics(site, Admission(site))
    pipeline.is_clock_set = True
    assert "no corrections: this machine's clock was set" in diagnostics.now(pipeline, 0)["clock"]
    pipeline.is_clock_set = False
    assert diagnostics.now(pipeline, 1) == {}


def test_whom_the_site_file_does_not_have_is_named_while_it_sends(charuco: Session) -> None:
    pipeline, site = live(charuco), charuco.inputs.site
    admission = Admission(site)
    diagnostics = Diagnostics(site, admission)
    assert not admission.knows("lab/camera/c7/sightings")
    text = diagnostics.now(pipeline, to_ns(1.0))["unknown_sender"]
    assert "does not have who sends lab/camera/c7/sightings; add it there" in text
    assert diagnostics.now(pipeline, to_ns(10.0)) == {}
    diagnostics.restart()  # a new map: nobody has sent anything since
    assert diagnostics.now(pipeline, to_ns(20.0)) == {}
