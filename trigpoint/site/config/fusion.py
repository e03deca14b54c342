"""`[fusion]`: the estimator and its priors."""

from typing import Literal

from msgspec import Struct

from .number_types import NotNegative, Positive, Probability


class PriorConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Prior probabilities of what may have gone wrong, and the size of the site.

    `wrong_sighting`: a sighting shows something other than its robot where it stands;
    `wild_corner`: a corner of a good sighting lies so far off that it is left out; `disturbed`:
    somebody carried a robot or moved a camera at some time in the session; `event`: in such a
    session, a robot is put down elsewhere or a camera is moved between one visit and the next
    (who interferes once is likely to do so again); `push_translation`, `push_rotation`: every other
    camera that was moved was only pushed, by about so much along and about each axis (standard
    deviations, m and rad), and is not elsewhere in the room; `noise`: the noise is far from what
    the site file states, in a session too short to tell; `floor_tilt`, `target_sway`: how much
    floors slope, and targets sway on their robots, of which nothing tells (root mean square, rad,
    m; 0: they do not); `room`: the box, metres, in which cameras hang and robots drive.
    """

    wrong_sighting: Probability = 0.02
    wild_corner: Probability = 1e-4
    disturbed: Probability = 1e-4
    event: Probability = 1e-2
    push_translation: Positive = 0.1
    push_rotation: Positive = 0.1
    noise: Probability = 5e-4
    floor_tilt: NotNegative = 0.0035
    target_sway: NotNegative = 0.0005
    room: tuple[Positive, Positive, Positive] = (30.0, 30.0, 5.0)


class FusionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The estimator. `learn`: false where the network is fixed, and corrections are made only."""

    estimator: Literal["smoother", "particle", "ekf"] = "smoother"
    late: Positive = 1.0
    correction_rate: Positive = 10.0
    seed: int = 0
    learn: bool = True
    target_translation: NotNegative = 0.0
    target_rotation: NotNegative = 0.0
    priors: PriorConfig = PriorConfig()
