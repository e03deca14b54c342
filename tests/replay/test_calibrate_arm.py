"""`calibrate` over a session of a robot that moves in space: an arm with a board on its wrist."""

from pathlib import Path

import numpy as np
import pytest
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
