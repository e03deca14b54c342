"""What noise is not as stated, in words."""

import math

from small_problems import small_data

from trigpoint.fusion.estimators.noise_lines import noise_lines
from trigpoint.fusion.model.jitter import Jitter


def test_nothing_is_said_where_all_is_as_stated() -> None:
    data = small_data()
    data.odometry_scale, data.corner_scale = {"r1": (1.0, 1.0)}, {"c1": 1.0}
    data.jitter = {"r2": Jitter(sway=1e-6, tilt=1e-6)}
    assert noise_lines(data) == ()


def test_each_kind_of_noise_has_its_line() -> None:
    data = small_data()
    data.jitter = {
        "r1": Jitter(sway=1e-6, tilt=math.radians(0.3), length=2.0),
        "r2": Jitter(sway=0.0012, tilt=math.radians(0.1)),
    }
    data.odometry_scale = {"r1": (0.5, 0.1), "r2": (2.0, 3.0)}
    data.corner_scale = {"c1": 1.0, "c2": 1.8}
    assert noise_lines(data) == (
        "r1: tilts by 0.30° with a floor whose slope changes over 2.0 m",
        "r1: odometry has 0.5 times its stated noise",
        "r2: tilts by 0.10° anew in each picture",
        "r2: target sways by 1.2 mm",
        "r2: odometry has 2 times its stated noise",
        "r2: slips 3 times as much as assumed where it turns",
        "c2: corners have 1.8 times their stated sigma",
    )


def test_what_holds_for_several_is_one_line() -> None:
    data = small_data()
    data.odometry_scale = {"r1": (2.0, 1.0), "r2": (2.0, 1.0)}
    data.corner_scale = {"c1": 0.41, "c2": 0.41}
    assert noise_lines(data) == (
        "all robots: odometry has 2 times its stated noise",
        "all cameras: corners have 0.41 times their stated sigma",
    )
