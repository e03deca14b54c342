"""What the page's addresses give, of a site on a bus in memory."""

import json
import socket
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from support.builders import eventually, make_site
from support.site.board_desk import Desk, served_board
from support.site.board_site import BoardSite, Truth

from trigpoint.contract import topics
from trigpoint.contract.messages import Picture
from trigpoint.contract.topics import command_key
from trigpoint.tools.board.feed import MOST_PAGES
from trigpoint.tools.board.reader import Reader
from trigpoint.tools.web import serving

State = dict[str, Any]

TRUTH = Truth(4, 2, is_still=True)


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    with served_board(make_site(cameras=4, robots=2), monkeypatch) as served:
        yield served


@pytest.fixture
def site(desk: Desk) -> BoardSite:
    return BoardSite(
        desk.broker.session(),
        make_site(cameras=4, robots=2),
        TRUTH,
        unlocated=frozenset({2}),
        unseen=frozenset({3}),
    )


def state_when(desk: Desk, site: BoardSite, holds: Callable[[State], bool]) -> State:
    """The state as a page has it, once something holds of it."""
    state: State = {}
    with desk.events() as messages:
        deadline = time.monotonic() + 30
        for message in messages:
            site.announce(time.time())
            site.move(time.time())
            state |= message.get("all", {})
            for name, fields in message.get("set", {}).items():
                state[name] = state.get(name, {}) | fields
            if holds(state):
                return state
            assert time.monotonic() < deadline, state
    raise AssertionError("the server ended the page")


def test_a_page_gets_the_truth(desk: Desk, site: BoardSite) -> None:
    nodes = [f"node/{node}" for node in site.nodes]
    state = state_when(
        desk,
        site,
        lambda s: "at" in s["robot/r2"] and all(s.get(n, {}).get("state") == "ok" for n in nodes),
    )
    for index in (0, 1):
        camera, robot = state[f"camera/c{index + 1}"], state[f"robot/r{index + 1}"]
        assert np.allclose(camera["at"], TRUTH.camera(index).translation, atol=6e-4)
        assert np.allclose(robot["at"], TRUTH.robot(index, 0.0), atol=6e-4)
    assert [state[f"camera/c{i}"]["state"] for i in (1, 2, 3, 4)] == [
        "located", "located", "undetermined", "unseen",
    ]  # fmt: skip


def test_who_disappears_and_who_is_in_trouble_is_an_alarm(desk: Desk, site: BoardSite) -> None:
    def alarms(state: State) -> set[tuple[object, object]]:
        return {(f["node"], f["text"]) for n, f in state.items() if n.startswith("alarm/")}

    site.troubles["edge/c2"] = "the camera hangs"
    site.end("robot/r1")
    wanted = {("edge/c2", "the camera hangs"), ("robot/r1", "named in the site file; not running")}
    assert wanted <= alarms(state_when(desk, site, lambda state: wanted <= alarms(state)))


def test_events_are_packed_where_the_browser_takes_it(desk: Desk) -> None:
    connection = desk.connected()
    connection.request("GET", "/events", headers={"Accept-Encoding": "gzip"})
    answer = connection.getresponse()
    assert answer.getheader("Content-Encoding") == "gzip"
    unpacked, unpacker = b"", zlib.decompressobj(31)
    while unpacked.count(b"data: ") < 3:
        unpacked += unpacker.decompress(answer.read1())
    connection.close()
    first = unpacked.split(b"data: ")[1].partition(b"\n")[0]
    assert json.loads(first)["all"]["site"]["name"] == "lab"


def test_there_is_a_past_from_the_first_answer_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Reader, "run", lambda _, bus, stopping: bus and stopping.wait(10))
    with served_board(make_site(), monkeypatch) as desk:
        assert desk.ask("/past?at=1").status == 200


def test_the_past_is_what_was(desk: Desk, site: BoardSite) -> None:
    state_when(desk, site, lambda state: "at" in state.get("robot/r1", {}))
    assert eventually(lambda: "at" in json.loads(desk.ask("/past?at=9e9").body)["all"]["robot/r1"])
    whole = json.loads(desk.ask("/past?at=9e9").body)
    assert np.allclose(whole["all"]["robot/r1"]["at"], TRUTH.robot(0, 0.0), atol=6e-4)
    assert whole["past"] is True


def test_the_metrics_of_all_nodes_are_on_one_page(desk: Desk, site: BoardSite) -> None:
    state_when(desk, site, lambda state: "node/fusion/fusion" in state)
    site.announce(time.time())
    assert eventually(lambda: b'node="edge/c1"' in desk.ask("/metrics").body)
    text = desk.ask("/metrics").body.decode()
    assert 'trigpoint_pictures_total{camera="c4",node="edge/c4",site="lab"} 1000.0' in text
    assert 'trigpoint_node_level{node="robot/r2",robot="r2",site="lab"} 0.0' in text
    assert 'trigpoint_queue_received_total{node="board",queue="robot_pose",site="lab"}' in text


def test_who_is_missing_is_in_error_on_the_page_of_metrics(desk: Desk, site: BoardSite) -> None:
    site.announce(time.time())
    missing = b'trigpoint_node_level{camera="c1",node="edge/c1",site="lab"} 2.0'
    assert eventually(lambda: missing in desk.ask("/metrics").body, 20.0)
    site.announce(time.time())
    heard = b'trigpoint_node_level{camera="c1",node="edge/c1",site="lab"} 0.0'
    assert eventually(lambda: heard in desk.ask("/metrics").body)
    assert desk.ask("/metrics").body.count(b'level{camera="c1",') == 1


def test_a_picture_leaves_the_camera_only_while_it_is_looked_at(
    desk: Desk, site: BoardSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.tools.board.pictures._IDLE_S", 0.5)
    sender = desk.broker.session().publisher(topics.IMAGE, topics.IMAGE.key("lab", "c1"))
    assert not sender.has_listener
    assert desk.ask("/camera/c1/look").status == 503  # asked for, and none comes
    assert sender.has_listener
    stamp_ns = time.time_ns()
    site.move(stamp_ns / 1e9)
    site.put(topics.IMAGE, "c1", Picture(round(1e9 * (stamp_ns / 1e9)), "", "jpeg", b"\xff\xd8xyz"))
    answer = desk.ask("/camera/c1/look")
    assert answer.status == 200, answer.body
    found = json.loads(answer.body)
    assert found["faces"][0]["target"] == "two-plane"
    assert found["faces"][0]["pixels"][:4] == [200, 150, 220, 150]
    picture = desk.ask(f"/camera/c1/picture/{found['stamp']}")
    assert (picture.body, picture.headers["content-type"]) == (b"\xff\xd8xyz", "image/jpeg")
    assert desk.ask("/camera/c1/picture/17").status == 404
    assert eventually(lambda: not sender.has_listener)


def test_no_command_goes_to_the_bus(
    desk: Desk, site: BoardSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trigpoint.tools.board.pictures._WAIT_S", 0.1)
    asked: list[str] = []
    own = {"Origin": f"http://127.0.0.1:{desk.port}"}
    with desk.broker.session() as bus:
        for path in ("camera/c1/snapshot", "camera/c1/calibrate", "fusion/reset", "fusion/network"):
            bus.serve(command_key("lab", path), lambda _, path=path: asked.append(path) or b"")
        state_when(desk, site, lambda state: "node/fusion/fusion" in state)
        for path in ("/", "/camera/c1/look", "/past?at=1", "/metrics"):
            desk.ask(path)
        for path in ("/command/fusion/reset", "/command/camera/c1/snapshot"):
            desk.ask(path, "POST", **own)
    assert asked == []
    senders = {publisher._identity for publisher in desk.broker.publishers}
    assert senders == {site._bus.identity}  # the board itself has nothing to send on


def test_an_operators_commands_go_to_the_bus_and_no_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[str] = []
    with (
        served_board(make_site(cameras=2), monkeypatch, is_operator=True) as desk,
        desk.broker.session() as bus,
    ):
        for path in ("camera/c1/snapshot", "camera/c1/calibrate", "fusion/reset"):
            bus.serve(command_key("lab", path), lambda _, path=path: asked.append(path) or b"{}")
        own = {"Origin": f"http://127.0.0.1:{desk.port}"}
        for headers in ({}, {"Origin": "http://evil.example"}, {"Origin": "null"}):
            assert desk.ask("/command/fusion/reset", "POST", **headers).status == 403
        assert desk.ask("/command/fusion/reset").status == 405
        for path in ("camera/c1/calibrate", "camera/*/snapshot", "**", "../x"):
            assert desk.ask(f"/command/{path}", "POST", **own).status == 404, path
        assert asked == []
        assert desk.ask("/command/fusion/reset", "POST", **own).status == 200
        answer = desk.ask("/command/camera/c1/snapshot", "POST", **own)
        assert (answer.status, answer.headers["content-type"]) == (200, "image/jpeg")
        assert asked == ["fusion/reset", "camera/c1/snapshot"]
        answer = desk.ask("/command/camera/c2/snapshot", "POST", **own)
        assert (answer.status, b"nobody answers" in answer.body) == (503, True)


def test_a_page_that_does_not_read_is_dropped_and_its_connection_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(serving, "_UNREAD_MS", 1000)
    monkeypatch.setattr("trigpoint.tools.web.answers.SEND_S", 1.0)
    with served_board(make_site(), monkeypatch) as desk:
        slow = socket.socket()
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", desk.port))
        slow.sendall(b"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        feed = desk.service._feed
        assert eventually(lambda: feed.pages == 1)
        with desk.events() as quick:
            number, until_s = 0, time.monotonic() + 60
            while feed.dropped == 0:
                feed.update({"a": {"x": str(number) * 200_000}}, time.time())
                number += 1
                assert time.monotonic() < until_s
                message = next(quick)  # the other one goes on
                while "a" not in message.get("set", {}):
                    message = next(quick)
                assert message["set"]["a"]["x"].startswith(str(number - 1))
        slow.settimeout(30)
        with suppress(ConnectionResetError):  # or what was buffered, and an end; no time-out
            while slow.recv(1 << 20):
                pass
        slow.close()


def test_pages_are_bounded(desk: Desk) -> None:
    connections = [desk.connected() for _ in range(MOST_PAGES)]
    for connection in connections:
        connection.request("GET", "/events")
        assert connection.getresponse().status == 200
    answer = desk.ask("/events")
    assert (answer.status, answer.body) == (503, b"24 pages are open already; close one")
    for connection in connections:
        connection.close()
    assert eventually(lambda: desk.service._feed.pages == 0)


def test_who_asks_for_nothing_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_REQUEST_S", 1.0)
    with served_board(make_site(), monkeypatch) as desk:
        idle = [socket.create_connection(("127.0.0.1", desk.port)) for _ in range(70)]
        idle[0].sendall(b"GET / HT")
        page = desk.connected()
        assert eventually(lambda: desk.ask("/").status == 200)
        page.request("GET", "/events")
        events = page.getresponse()
        assert events.status == 200
        for one in idle:
            one.settimeout(20)
            assert one.recv(10) == b""
            one.close()
        time.sleep(1.5)
        assert events.readline() == b"retry: 1000\n"  # who listens is not idle
        assert desk.service._feed.pages == 1
        page.close()


def test_it_stops_at_once_with_pages_open(monkeypatch: pytest.MonkeyPatch) -> None:
    with served_board(make_site(), monkeypatch) as desk:
        connection = desk.connected()
        connection.request("GET", "/events")
        connection.getresponse()
        begin = time.monotonic()
    assert time.monotonic() - begin < 1.9
    connection.close()


def test_the_files_of_the_page_are_kept_by_the_browser(desk: Desk) -> None:
    answer = desk.ask("/board.js", Accept_Encoding="gzip")
    assert answer.headers["content-encoding"] == "gzip"
    again = desk.ask("/board.js", If_None_Match=answer.headers["etag"])
    assert (again.status, again.body) == (304, b"")
