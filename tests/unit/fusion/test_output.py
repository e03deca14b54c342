"""What fusion's diagnostics say of how well cameras are known."""

import numpy as np
import pytest

from trigpoint.contract import topics
from trigpoint.contract.messages import PoseEstimate, Transform, Transforms
from trigpoint.fusion.output import CameraAccuracy, Output
from trigpoint.geometry import Pose


def test_a_camera_is_known_to_the_root_of_the_trace_as_everywhere_else() -> None:
    accuracy = CameraAccuracy(["c1", "c2"])
    covariance = np.diag([0.01, 0.02, 0.02, 1e-4, 1e-4, 1e-4]) ** 2
    here = Pose.identity()
    accuracy.words_after(Output(topics.CAMERA_POSE, "c1", PoseEstimate(0, "map", here, covariance)))
    located = Transforms((Transform(0, "map", "c1/camera", here),))
    assert (
        accuracy.words_after(Output(topics.TF_STATIC, "", located)) == "c1 ±3.0 cm, c2 not located"
    )
    assert accuracy.worst_sigma_m == pytest.approx(0.03)
