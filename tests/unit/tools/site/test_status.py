import json
import re
import threading
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import msgspec
from support.builders import site_text
from support.commands import Cli

from trigpoint.contract.messages import DiagnosticStatus
from trigpoint.contract.topics import DIAGNOSTICS
from trigpoint.node.node import Node
from trigpoint.site.config import parse_site
from trigpoint.testing.memory_bus import MemoryBroker
from trigpoint.tools.site.state import NodeStatus, SiteStatus, summarise, table
from trigpoint.tools.site.status import look, wanted_of
from trigpoint.zenoh import open_bus


def test_tokens_and_diagnostics_are_put_together() -> None:
    values = {"odom.rate": "50.0", "odom.total": "500", "odom.lost": "2", "queue.depth": "3"}
    more = {"uptime": "10.5", "version": "0.1.0", "contract": "1", "last_error": "slipped"}
    speaks = DiagnosticStatus(1, "robot/r1", "lost", "host", values | more | {"offset": "0.5"})
    left = DiagnosticStatus(0, "edge/c1", "running", "host", {})
    status = summarise(
        "lab",
        peers=2,
        tokens=["lab/alive/robot/r1", "lab/alive/fusion/fusion"],
        statuses=[left, speaks],
    )
    gone, silent, robot = status.nodes
    assert (gone.name, gone.state) == ("edge/c1", "gone")
    assert (silent.name, silent.state) == ("fusion/fusion", "silent")
    assert robot == NodeStatus(
        name="robot/r1",
        state="warning",
        message="lost",
        host="host",
        version="0.1.0",
        contract="1",
        uptime_s=10.5,
        rates={"odom": 50.0},
        totals={"odom": 500},
        depths={"queue": 3},
        losses={"odom": 2},
        gauges={"offset": 0.5},
        last_error="slipped",
    )


def test_agent_of_a_camera_that_the_site_file_does_not_have_is_named() -> None:
    statuses = [DiagnosticStatus(0, f"edge/c{i}", "running", "", {}) for i in (1, 2)]
    statuses += [DiagnosticStatus(2, "robot/r9", "no port", "", {})]
    tokens = [f"lab/alive/{status.name}" for status in statuses]
    site = summarise("lab", peers=0, tokens=tokens, statuses=statuses, known=["edge/c1"])
    known, added, robot = site.nodes
    assert (known.state, known.message) == ("ok", "running")
    assert (added.state, robot.state) == ("warning", "error")
    assert "the site file has no camera «c2»" in table(site, width=1000)
    assert "no robot «r9», so others may leave it out" in robot.message
    assert robot.message.endswith("; no port")


def test_where_nobody_answers_nobody_is_said_to_be_missing() -> None:
    site = summarise(
        "lab",
        peers=0,
        tokens=[],
        statuses=[],
        wanted=["edge/c1"],
        expect=["fusion"],
        unreached=("tcp/127.0.0.1:7447",),
    )
    assert (site.nodes, site.is_well) == ([], False)
    assert "nobody is heard: nobody answers at tcp/127.0.0.1:7447 (bus.connect)" in table(site)


def test_rates_of_keys_are_added_up_for_people() -> None:
    values = {f"sent lab/camera/c{i}/pose.rate": "1.5" for i in (1, 2)} | {"pictures.rate": "5.0"}
    status = DiagnosticStatus(0, "fusion/fusion", "running", "", values)
    site = summarise("lab", peers=0, tokens=["lab/alive/fusion/fusion"], statuses=[status])
    assert site.nodes[0].rates["sent lab/camera/c2/pose"] == 1.5
    assert "sent camera_pose 3, pictures 5" in table(site)


def test_numbers_that_are_none_do_not_break_the_view() -> None:
    values = {"a.rate": "fast", "b.total": "nan", "c.lost": "1e400", "uptime": "-"}
    status = DiagnosticStatus(3, "robot/r1", "", "", values)
    [node] = summarise("lab", peers=0, tokens=["lab/alive/robot/r1"], statuses=[status]).nodes
    assert (node.state, node.rates, node.totals, node.losses) == (
        "stale",
        {"a": 0.0},
        {"b": 0},
        {"c": 0},
    )


def test_table_shows_rates_losses_and_errors() -> None:
    node = NodeStatus(
        "robot/r1",
        "error",
        "no",
        uptime_s=9.6,
        rates={"odom": 50.0},
        losses={"odom": 2},
        last_error="x",
    )
    text = table(SiteStatus("lab", 3, [node]))
    lines = text.splitlines()
    assert re.split(" {2,}", lines[-4]) == ["robot/r1", "error", "10 s", "odom 50"]
    assert [line.strip() for line in lines[-3:]] == ["lost: 2 odom", "no", "last error: x"]


def test_nodes_of_another_version_are_named() -> None:
    versions = {"edge/c1": "0.2", "edge/c2": "0.2", "robot/r1": "0.1", "edge/c3": "0.0"}
    statuses = [
        DiagnosticStatus(0, name, "running", "", {"version": version, "node": name})
        for name, version in versions.items()
    ]
    tokens = [f"lab/alive/{name}" for name in versions if name != "edge/c3"]
    site = summarise("lab", peers=0, tokens=tokens, statuses=statuses)
    assert site.versions == {"0.2": ["edge/c1", "edge/c2"], "0.1": ["robot/r1"]}
    last = table(site).splitlines()[-1]
    assert last == "Versions differ: 0.2 on most, but 0.1: robot/r1"
    alike = summarise("lab", peers=0, tokens=tokens[:2], statuses=statuses[:2])
    assert "Versions differ" not in table(alike)


def test_table_keeps_to_its_width() -> None:
    keys = [f"sent lab/{kind}.rate" for kind in ("tf", "diagnostics", "coverage/c1")]
    status = DiagnosticStatus(0, "fusion/fusion", "running", "", dict.fromkeys(keys, "5"))
    site = summarise("lab", peers=0, tokens=["lab/alive/fusion/fusion"], statuses=[status])
    lines = table(site, width=60).splitlines()
    assert max(map(len, lines[2:])) <= 60
    assert " ".join(line.strip() for line in lines).endswith("5")


def test_rate_of_a_queue_is_not_told_twice() -> None:
    rates = {"sightings": 10.0, "received lab/camera/c1/sightings": 10.0}
    text = table(SiteStatus("lab", 0, [NodeStatus("fusion/fusion", "ok", rates=rates)]))
    assert text.splitlines()[-1].endswith("  received sightings 10")
    assert "Nobody is alive on site lab" in table(SiteStatus("lab", 0, []))


def test_look_hears_the_nodes_and_skips_garbage() -> None:
    broker = MemoryBroker()
    with (
        broker.session() as bus,
        Node(bus, site="lab", kind="edge", name="c1", period_s=0.02),
        broker.session() as mine,
    ):
        bus.publisher(DIAGNOSTICS, DIAGNOSTICS.key("lab")).put(b"garbage")
        status = look(mine, "lab", threading.Event(), listen_s=1.0)
    assert [(node.name, node.state) for node in status.nodes] == [("edge/c1", "error")]
    assert "rejected" in status.nodes[0].message


def test_command_shows_the_live_site(
    tmp_path: Path, free_port: Callable[[], int], cli: Cli
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    path = tmp_path / "site.toml"
    path.write_text(site_text(bus=f'connect = ["{endpoint}"]'))
    serving = parse_site(site_text(bus=f'listen = ["{endpoint}"]'), directory=tmp_path)
    with open_bus(serving) as bus, Node(bus, site="lab", kind="edge", name="c1"):
        # The bridge of robot r1, which the site file names, does not run.
        status = json.loads(cli("status", "--site", path, "--json", status=1).out)
        assert [(node["name"], node["state"]) for node in status["nodes"]] == [
            ("edge/c1", "ok"),
            ("robot/r1", "missing"),
        ]
        assert datetime.fromisoformat(status["time"]).utcoffset() is not None
        with Node(bus, site="lab", kind="robot", name="r1"):
            cli("status", "--site", path)


def test_states_in_words_stay_words() -> None:
    values = {"source": "lost", "stamps": "on arrival", "picture_age_s": "12.5"}
    status = DiagnosticStatus(2, "edge/c1", "gone", "", values)
    site = summarise("lab", peers=0, tokens=["lab/alive/edge/c1"], statuses=[status])
    assert site.nodes[0].words == {"source": "lost", "stamps": "on arrival"}
    assert site.nodes[0].gauges == {"picture_age_s": 12.5}
    assert not site.is_well
    assert "source: lost" in table(site)


def test_what_was_seen_alive_or_is_expected_is_missing_where_nobody_runs_it() -> None:
    bridge = DiagnosticStatus(0, "robot/r1", "running", "", {"met": "fusion, recorder"})
    tokens = ["lab/alive/robot/r1", "lab/alive/recorder/recorder"]

    def missing(expect: list[str] | None, *heard: DiagnosticStatus) -> list[tuple[str, str]]:
        site = summarise("lab", peers=1, tokens=tokens, statuses=[*heard], expect=expect)
        assert site.is_well == all(node.state == "ok" for node in site.nodes)
        return [(node.name, node.message) for node in site.nodes if node.state == "missing"]

    silent = DiagnosticStatus(0, "recorder/recorder", "running", "", {})
    [(name, why)] = missing(None, bridge, silent)
    assert (name, "was running" in why) == ("fusion/fusion", True)
    assert missing([], bridge, silent) == []
    assert missing(["recorder"], bridge, silent) == []
    [(name, why)] = missing(["fusion"], bridge, silent)
    assert (name, "expected by the site file" in why) == ("fusion/fusion", True)
    unmet = DiagnosticStatus(0, "robot/r1", "running", "", {"met": ""})
    assert missing(None, unmet, silent) == []


def test_faces_are_told_instead_of_messages_and_each_trouble_once() -> None:
    rates = {"pictures": 5.0, "sent lab/camera/c1/sightings": 5.0, "faces": 0.0}
    agent = NodeStatus("edge/c1", "warning", "lost so far: 2 pictures", rates=rates)
    agent = msgspec.structs.replace(agent, losses={"pictures": 2})
    text = table(SiteStatus("lab", 0, [agent]))
    assert "pictures 5, faces 0" in text
    assert (text.count("sightings"), text.count("2 pictures")) == (0, 1)
    error, last = (f"no corrections for {seconds} s: fusion" for seconds in (21, 11))
    bridge = NodeStatus("robot/r1", "error", error, last_error=last)
    assert "last error" not in table(SiteStatus("lab", 0, [bridge]))


def test_a_loss_is_told_once_also_of_a_node_with_a_complaint() -> None:
    status = DiagnosticStatus(1, "edge/c9", "lost so far: 5 pictures", "", {"pictures.lost": "5"})
    tokens = ["lab/alive/edge/c9"]
    site = summarise("lab", peers=1, tokens=tokens, statuses=[status], known=[])
    text = table(site, width=1000)
    assert "the site file has no camera «c9»" in text
    assert text.count("5 pictures") == 1


def test_a_robot_without_a_port_needs_no_bridge(tmp_path: Path) -> None:
    """It speaks ROS 2 on the bus, also where the file does not say so."""
    site = parse_site(site_text(robots=1, more="[robots.r2]"), directory=tmp_path)
    assert wanted_of(site) == ["edge/c1", "robot/r1"]
