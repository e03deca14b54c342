"""What noise is not as stated, in words."""

import math

from support.fusion.small_problems import small_data

from trigpoint.fusion.estimators.noise_lines import noise_lines
from trigpoint.fusion.model.jitter import Jitter


def test_nothing_is_said_where_all_is_as_stated() -> None:
    data = small_data()
    data.odometry_scale, data.corner_scale = {"r1": (1.0, 1.0)}, {"c1": 1.0}
    data.jitter = {"r2": Jitter(sway=1e-6, tilt=1e-6)}
    assert noise_lines(data) == ()


def test_each_kind_of_noise_is_named() -> None:
    data = small_data()
    data.jitter = {
        "r1": Jitter(sway=1e-6, tilt=math.radians(0.3), length=2.0),
        "r2": Jitter(sway=0.0012, tilt=math.radians(0.1)),
    }
    data.odometry_scale = {"r1": (0.5, 0.1), "r2": (2.0, 3.0)}
    data.corner_scale = {"c1": 1.0, "c2": 1.8}
    assert noise_lines(data) == (
        "r1: a tilt of 0.30° by a floor whose slope changes over 2.0 m, "
        "0.5 times the stated noise of odometry",
        "r2: a tilt of 0.10° in each picture anew, a target that sways by 1.2 mm, "
        "2 times the stated noise of odometry, 3 times the assumed slip in turns",
        "c2: 1.8 times the stated sigma of corners",
    )


def test_slope_that_nothing_tells_is_said_to_be_none_that_was_seen() -> None:
    data = small_data()
    priors = data.site.fusion.priors
    data.jitter = {"r1": Jitter(priors.target_sway, priors.floor_tilt, length=1.0)}
    assert noise_lines(data) == (
        "r1: a floor that may slope by 0.20° and a target that may sway by 0.5 mm, as far as "
        "pictures tell",
    )
    data.jitter = {"r1": Jitter(priors.target_sway, 1e-6, length=0.0)}
    assert noise_lines(data) == ("r1: a target that may sway by 0.5 mm, as far as pictures tell",)
    data.jitter = {"r1": Jitter(0.002, priors.floor_tilt, length=1.0)}
    assert noise_lines(data) == (
        "r1: a floor that may slope by 0.20°, as far as pictures tell, "
        "a target that sways by 2.0 mm",
    )


def test_what_holds_for_several_is_one_line() -> None:
    data = small_data()
    data.odometry_scale = {"r1": (2.0, 1.0), "r2": (2.0, 1.0)}
    data.corner_scale = {"c1": 0.41, "c2": 0.41}
    assert noise_lines(data) == (
        "all robots: 2 times the stated noise of odometry",
        "all cameras: 0.41 times the stated sigma of corners",
    )
