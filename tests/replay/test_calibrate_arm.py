"""`calibrate` over a session of a robot that moves in space: an arm with a board on its wrist."""

import re
from pathlib import Path

import numpy as np
import pytest
from support.commands import Cli
from support.pictures.arm_session import ABOUT, ARM, write_arm_session

from trigpoint.recorder.session.recording import open_recording
from trigpoint.tools.calibrate.work import calibrated
from trigpoint.tools.sessions.inputs import session_inputs

pytestmark = pytest.mark.skipif(not ARM.is_dir(), reason=f"the arm's pictures are not at {ARM}")

# By the data's own table: the whole chain solved with OpenCV, sigmas of 1.2 to 2.7 mm.
CAMERA_M = (-0.019, 1.264, 0.289)


def test_camera_before_an_arm_is_located_and_the_board_on_its_wrist_found(tmp_path: Path) -> None:
    recording = open_recording(write_arm_session(tmp_path))
    results = calibrated(recording, session_inputs(recording, site=None, network=None))
    record = results.network.cameras["c1"]
    assert record.map_from_camera is not None
    # Within two of both sigmas: the arm errs by 0.4°, which is learnt, and three pictures by more.
    assert np.linalg.norm(np.subtract(record.map_from_camera.translation, CAMERA_M)) < 0.006
    assert 0.001 < record.position_sigma < 0.01
    (face,) = results.network.robots["r1"].target.faces
    # The start's centimetre and five degrees, and what that leaves at the board's far corners.
    assert 0.001 < np.linalg.norm(np.subtract(face.translation, ABOUT.translation)) < 0.015


def test_a_lens_that_is_off_by_millimetres_is_no_lens_to_use(tmp_path: Path, cli: Cli) -> None:
    """By less than anybody can tell: it stays located, and is said not to be."""
    said = cli("calibrate", write_arm_session(tmp_path), "--out", tmp_path / "out", status=1)
    assert re.search(r"c1 +located", said.out)
    assert "do not use these cameras: cameras are farther off than their sigmas" in said.err
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<h1>Do not use these cameras</h1>" in page
    assert page.index("do not fit its lens") < page.index("cameras located")
