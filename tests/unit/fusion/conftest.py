"""Drives that many tests look at, made and solved once."""

import pytest
from support.fusion.drives import Session, lab_plan, make_session, offline, pushed, standing_plan

from trigpoint.fusion.estimators.results import Results
from trigpoint.fusion.pipeline import Pipeline


@pytest.fixture(scope="session")
def charuco() -> Session:
    """Three cameras around a robot whose faces tell which they are."""
    return make_session(lab_plan("charuco"))


@pytest.fixture(scope="session")
def checkerboard() -> Session:
    """The same with the paper's boards: six faces alike, each readable from either end."""
    return make_session(lab_plan("checkerboard", picture_rate=1.25))


@pytest.fixture(scope="session", params=["charuco", "checkerboard"])
def session(request: pytest.FixtureRequest, charuco: Session, checkerboard: Session) -> Session:
    """Either drive."""
    return charuco if request.param == "charuco" else checkerboard


@pytest.fixture(scope="session")
def charuco_results(charuco: Session) -> Results:
    """What `calibrate` makes of the drive."""
    return offline(charuco)


@pytest.fixture(scope="session")
def results(session: Session, charuco: Session, charuco_results: Results) -> Results:
    """The same of either drive."""
    return charuco_results if session is charuco else offline(session)


@pytest.fixture(scope="session")
def standing() -> Session:
    """A robot that stands for long before it drives."""
    return make_session(standing_plan())


@pytest.fixture(scope="session")
def standing_bounded(standing: Session) -> Pipeline:
    """What `calibrate` makes of it."""
    return pushed(standing.inputs, standing.messages)
