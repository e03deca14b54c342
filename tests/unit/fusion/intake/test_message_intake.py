"""When a sighting is ready: its robot's odometry reaches the moment at which it was seen."""

from pathlib import Path

import numpy as np
import pytest
from support.builders import make_target
from support.fusion.drives import EPOCH_NS, lens

from trigpoint.base.clock import to_ns
from trigpoint.contract.messages import FaceSighting, Sightings
from trigpoint.fusion.inputs import Inputs
from trigpoint.fusion.intake.message_intake import Intake
from trigpoint.fusion.intake.standstills import MOST_ALIKE
from trigpoint.site.config import parse_site
from trigpoint.site.target import Target

SITE = """
site = "lab"
target = "target.toml"
[cameras.c1]
source = "sim://c1"
time_offset_sigma = 0.05
[cameras.c2]
source = "sim://c2"
[robots.r1]
port = "loop://"
"""


@pytest.fixture
def intake() -> Intake:
    inputs = Inputs(parse_site(SITE, directory=Path()), {"r1": make_target()})
    return Intake(inputs.data_set())


def see(intake: Intake, camera: str, seconds: float) -> bool:
    target = make_target()
    pixels = np.zeros((4, 2), np.float32)
    face = FaceSighting(target.name, target.faces[0].id, np.arange(4, dtype=np.uint16), pixels, 0.2)
    stamp_ns = EPOCH_NS + to_ns(seconds)
    return intake.add(camera, Sightings(stamp_ns, f"{camera}/optical", 640, 480, (face,)), lens())


def ready(intake: Intake, last_s: float) -> list[str]:
    found = intake.ready("r1", EPOCH_NS, EPOCH_NS + to_ns(last_s))
    return [observation.camera for observation in found]


def test_sighting_waits_for_what_its_clock_may_be_behind(intake: Intake) -> None:
    see(intake, "c1", 1.0)
    see(intake, "c2", 1.0)
    assert ready(intake, 1.1) == ["c2"]
    assert ready(intake, 1.16) == ["c1"]


def test_sighting_waits_no_longer_than_its_offset_once_that_is_known(intake: Intake) -> None:
    intake.learn("c1", 0.04, 0.001)  # stamps are ahead of true time
    see(intake, "c1", 1.0)
    assert ready(intake, 0.95) == []
    assert ready(intake, 0.97) == ["c1"]
    intake.learn("c1", -0.04, 0.001)
    see(intake, "c1", 2.0)
    assert ready(intake, 2.03) == []
    assert ready(intake, 2.05) == ["c1"]


def test_stamp_before_odometry_is_taken_where_the_clock_may_be_behind(intake: Intake) -> None:
    see(intake, "c1", -0.1)
    see(intake, "c2", -0.1)
    see(intake, "c1", -0.2)
    assert ready(intake, 5.0) == ["c1"]
    assert intake.left_out.counts["before_odometry"] == 2


def test_last_sightings_of_a_session_are_not_lost(intake: Intake) -> None:
    see(intake, "c1", 1.0)
    see(intake, "c1", 1.2)
    assert ready(intake, 1.1) == []
    rest = intake.rest("r1", EPOCH_NS + to_ns(1.1))
    assert [observation.stamp_ns for observation in rest] == [EPOCH_NS + to_ns(1.0)]
    assert intake.depth == 1


def test_of_twins_that_stand_a_stated_number_adds_to_the_map() -> None:
    """So many are written into the checkpoint; the others are used and forgotten."""
    site = parse_site(f'{SITE}[robots.r2]\nport = "loop://"\n', directory=Path())
    targets: dict[str, Target] = dict.fromkeys(("r1", "r2"), make_target())
    twins = Intake(Inputs(site, targets).data_set())
    added = [see(twins, "c1", 0.2 * number) for number in range(2 * MOST_ALIKE)]
    assert added == [True] * MOST_ALIKE + [False] * MOST_ALIKE
