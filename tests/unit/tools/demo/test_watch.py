from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from trigpoint.bus.bus import Bus
from trigpoint.contract.cdr import encode
from trigpoint.contract.messages import Diagnostics, DiagnosticStatus, PoseEstimate
from trigpoint.contract.topics import CAMERA_POSE, DIAGNOSTICS, ROBOT_POSE, Topic, alive_key
from trigpoint.geometry import Pose
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.demo.watch import Watch, totals

SIGHTINGS_KEY = "lab/camera/c1/sightings"


@pytest.fixture
def broker() -> MemoryBroker:
    return MemoryBroker()


@pytest.fixture
def bus(broker: MemoryBroker) -> Iterator[Bus]:
    with closing(broker.session()) as bus:
        yield bus


@pytest.fixture
def watch(broker: MemoryBroker) -> Iterator[Watch]:
    with closing(broker.session()) as bus, closing(Watch(bus, "lab")) as watch:
        yield watch


def put(bus: Bus, topic: Topic, key: str, payload: bytes) -> None:
    bus.publisher(topic, key).put(payload)


def say_counts(bus: Bus, name: str, counts: dict[str, int], life: str = "a") -> None:
    values = {"node": life} | {f"{key}.total": str(count) for key, count in counts.items()}
    message = Diagnostics(1, (DiagnosticStatus(0, name, "running", "here", values),))
    put(bus, DIAGNOSTICS, DIAGNOSTICS.key("lab"), encode(message))


def test_nodes_that_are_not_alive_are_missing(bus, watch):
    here, away = alive_key("lab", "edge", "c1"), alive_key("lab", "edge", "c2")
    bus.declare_alive(here)
    assert watch.missing([here, away]) == {away}


def test_newest_pose_of_each_camera_and_robot_counts(bus, watch):
    for sigma in (0.5, 0.1):
        covariance = np.diag([sigma**2, 0, 0, 0, 0, 0])
        pose = encode(PoseEstimate(1, "map", Pose.identity(), covariance))
        put(bus, CAMERA_POSE, CAMERA_POSE.key("lab", "c1"), pose)
        put(bus, ROBOT_POSE, ROBOT_POSE.key("lab", "r1"), pose)
    watch.read()
    assert watch.cameras == {"c1": pytest.approx(0.1)}
    assert watch.robots == {"r1": pytest.approx(0.1)}


def test_latest_counts_of_a_node_are_kept(bus, watch):
    say_counts(bus, "edge/c1", {"pictures": 3})
    say_counts(bus, "edge/c1", {"pictures": 5})
    watch.read()
    assert watch.counts() == {"edge/c1": {"pictures": 5}}


def test_counts_of_a_node_that_was_started_again_are_added_up(bus, watch):
    say_counts(bus, "edge/c1", {"pictures": 5}, life="a")
    say_counts(bus, "edge/c1", {"pictures": 2}, life="b")
    say_counts(bus, "edge/c2", {"pictures": 1})
    watch.read()
    assert watch.counts()["edge/c1"] == {"pictures": 7}
    assert watch.total("pictures") == 8


def test_site_is_settled_when_what_was_sent_has_been_received(bus, watch):
    say_counts(bus, "edge/c1", {f"sent {SIGHTINGS_KEY}": 10})
    say_counts(bus, "fusion/fusion", {f"received {SIGHTINGS_KEY}": 9})
    watch.read()
    assert not watch.is_settled("edge")
    say_counts(bus, "fusion/fusion", {f"received {SIGHTINGS_KEY}": 10})
    watch.read()
    assert watch.is_settled("edge")


def test_what_other_nodes_still_send_does_not_unsettle_the_site(bus, watch):
    say_counts(bus, "robot/r1", {"sent lab/robot/r1/odom": 10})
    watch.read()
    assert watch.is_settled("edge")
    assert not watch.is_settled("robot")


def test_best_effort_keys_do_not_unsettle_the_site(bus, watch):
    say_counts(bus, "edge/c1", {"sent lab/camera/c1/image/compressed": 10})
    watch.read()
    assert watch.is_settled("edge")


def test_counters_are_found_by_verb_and_key():
    counts = {"edge/c1": {f"sent {SIGHTINGS_KEY}": 10, "sent nothing/known": 1, "pictures": 3}}
    assert totals(counts, "sent") == {SIGHTINGS_KEY: {"edge/c1": 10}}
    assert totals(counts, "received") == {}


def test_garbage_does_not_end_the_watch(bus, watch):
    put(bus, DIAGNOSTICS, DIAGNOSTICS.key("lab"), b"garbage")
    put(bus, CAMERA_POSE, CAMERA_POSE.key("lab", "c1"), b"garbage")
    watch.read()
    assert watch.counts() == {}
    assert watch.cameras == {}
