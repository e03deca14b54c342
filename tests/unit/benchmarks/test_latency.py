"""Where the time from exposure to correction went, by a recording and the robot's journal."""

import json
from pathlib import Path

import numpy as np
from support.builders import make_odometry

from benchmarks.latency import stages_ms
from benchmarks.network.messages import STAMP_NS, sightings
from trigpoint.contract import cdr, topics
from trigpoint.contract.messages import Message, PoseEstimate, Sightings
from trigpoint.geometry import Pose
from trigpoint.recorder.mcap.writer import McapWriter

NOBODY = Sightings(STAMP_NS, "c1/optical", 640, 480, ())


def test_each_stage_is_as_late_as_its_messages_and_empty_pictures_do_not_count(
    tmp_path: Path,
) -> None:
    correction = PoseEstimate(STAMP_NS, "map", Pose.identity(), 1e-4 * np.eye(6))
    sent: list[tuple[topics.Topic, str, Message, int]] = [
        (topics.SIGHTINGS, "c1", sightings(), 20),
        (topics.SIGHTINGS, "c2", NOBODY, 5),
        (topics.ODOMETRY, "r1", make_odometry(STAMP_NS), 1),
        (topics.CORRECTION, "r1", correction, 32),
    ]
    with McapWriter(tmp_path / "session.mcap") as writer:
        for topic, node, message, late_ms in sent:
            at_ns = STAMP_NS + late_ms * 10**6
            key, payload = topic.key("lab", node), cdr.encode(message)
            writer.add(topic, key, payload, log_ns=at_ns + 10**6, published_ns=at_ns)
    notes = [
        {"kind": "belief", "stamp_ns": STAMP_NS},
        {"kind": "correction", "stamp_ns": STAMP_NS, "at_ns": STAMP_NS + 40 * 10**6},
    ]
    (tmp_path / "r1.jsonl").write_text("\n".join(map(json.dumps, notes)))
    assert stages_ms(tmp_path) == {
        "sightings sent": [20.0],
        "correction sent": [32.0],
        "taken by the robot": [40.0],
    }
