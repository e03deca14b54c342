"""Drives of the study that several tests look at, made once."""

import pytest
from msgspec import structs

from benchmarks.study.session import StudySession, simulated_session
from benchmarks.study.worlds import WORLDS


@pytest.fixture(scope="session")
def kidnapped() -> StudySession:
    """A robot that was lifted after two cameras, and meets three others before it shows."""
    return simulated_session("kidnapped", 0)


@pytest.fixture(scope="session")
def kidnapped_known() -> StudySession:
    """A robot that was lifted on its second lap, with a camera's pictures at 2 Hz: the lift lies
    where it lies, and half of the work is enough to find it."""
    file = structs.replace(WORLDS["two_laps"](), picture_rate=2.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(WORLDS, "two_laps", lambda: file)
        return simulated_session("kidnapped_known", 0)
