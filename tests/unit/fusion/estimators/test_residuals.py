"""What a solution leaves over of the corners, as it is handed out."""

import numpy as np
import pytest
from msgspec.structs import replace
from support.fusion.drives import Session, lab_plan, make_session, pushed

from trigpoint.contract.messages import Sightings
from trigpoint.fusion.pipeline import Pipeline

SHIFT_PX = np.array([9.0, -4.0])


@pytest.fixture(scope="module")
def session() -> Session:
    return make_session(lab_plan(picture_rate=1.0))


@pytest.fixture(scope="module")
def solved(session: Session) -> Pipeline:
    """With one corner of c1's fifth picture of the robot far off, and c2's fifth displaced."""
    messages, seen = [], {"c1": 0, "c2": 0, "c3": 0}
    for node, message in session.messages:
        if isinstance(message, Sightings) and message.faces:
            seen[node] += 1
            if seen[node] == 5 and node == "c1":
                face = message.faces[0]
                pixels = face.pixels.copy()
                pixels[2] += SHIFT_PX
                faces = (replace(face, pixels=pixels), *message.faces[1:])
                message = replace(message, faces=faces)
            if seen[node] == 5 and node == "c2":
                faces = tuple(replace(f, pixels=f.pixels + 15) for f in message.faces)
                message = replace(message, faces=faces)
        messages.append((node, message))
    return pushed(session.inputs, tuple(messages))


def test_residuals_are_as_large_as_the_stated_noise(solved: Pipeline) -> None:
    for found in solved.residuals().values():
        assert np.std(found.in_sigmas) == pytest.approx(1.0, abs=0.12)
        assert abs(np.mean(found.in_sigmas)) < 0.1
        assert found.pixels.shape == found.residual_px.shape == (len(found.used), 2)


def test_rms_is_that_of_the_network(solved: Pipeline) -> None:
    for name, found in solved.residuals().items():
        rms = np.sqrt(np.mean(found.residual_px[found.used] ** 2))
        assert rms == pytest.approx(
            solved.results().network.cameras[name].reprojection_rms, rel=1e-6
        )


def test_wild_corner_is_not_used_and_keeps_its_residual(solved: Pipeline) -> None:
    found = solved.residuals()["c1"]
    away = np.linalg.norm(found.residual_px + SHIFT_PX, axis=1)
    assert away.min() < 1.0  # predicted minus seen
    assert not found.used[np.argmin(away)]


def test_places_are_where_the_robot_stood(session: Session, solved: Pipeline) -> None:
    truth = session.truth["r1"].translation
    for found in solved.residuals().values():
        away = np.linalg.norm(truth[:, None] - found.places, axis=2).min(axis=0)
        assert len(found.places) >= 5
        assert away.max() < 0.05


def test_nothing_came_leaves_nothing(session: Session) -> None:
    for found in Pipeline(session.inputs, is_live=False).residuals().values():
        assert found.pixels.shape == (0, 2)
