"""What the tests of several commands work on."""

from pathlib import Path

import pytest
from support.fusion.drives import Session, lab_plan, make_session, write_session
from support.pictures.boards import CHARUCO_TARGET


@pytest.fixture(scope="session")
def drive() -> Session:
    """Once around, past three cameras that take a picture a second."""
    return make_session(lab_plan(picture_rate=1.0))


@pytest.fixture(scope="session")
def recorded(drive: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive's folder, in which nothing is to be written."""
    return write_session(drive, tmp_path_factory.mktemp("recorded"))


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """The file of a ChArUco board."""
    path = tmp_path / "target.toml"
    path.write_text(CHARUCO_TARGET)
    return path
