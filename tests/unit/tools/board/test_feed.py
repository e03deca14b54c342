"""Changes go to every page; one that does not read is dropped, and holds nobody up."""

import asyncio
import json

import pytest

from trigpoint.base.errors import OperationError
from trigpoint.tools.board.entities import apply, difference
from trigpoint.tools.board.feed import MOST_PAGES, MOST_WAITING, Feed


def messages(data: bytes) -> list[dict]:
    parts = data.decode().split("\n\n")
    return [json.loads(part.removeprefix("data: ")) for part in parts if part]


def test_only_fields_that_differ_are_a_change() -> None:
    shown = {"robot/r1": {"at": [1, 2], "sigma": 0.1}, "robot/r2": {"at": [0, 0]}}
    now = {"robot/r1": {"at": [1, 3], "sigma": 0.1}, "robot/r2": None, "robot/r3": None}
    change = difference(shown, now, 5.0)
    assert change.set == {"robot/r1": {"at": [1, 3]}}
    assert change.gone == ("robot/r2",)
    apply(shown, change)
    assert shown == {"robot/r1": {"at": [1, 3], "sigma": 0.1}}


def test_a_page_begins_with_the_whole_and_goes_on_with_changes() -> None:
    async def run() -> None:
        feed = Feed()
        feed.update({"robot/r1": {"at": [1, 2], "sigma": 0.1}}, 10.0)
        page = feed.join({"robot/r1": [0.0, 0.0, 1.0, 2.0]})
        feed.update({"robot/r1": {"at": [1, 3], "sigma": 0.1}}, 10.1)
        feed.update({"robot/r1": {"at": [1, 3], "sigma": 0.1}}, 10.2)  # nothing new
        whole, change = messages(await page.take())
        assert whole["all"] == {"robot/r1": {"at": [1, 2], "sigma": 0.1}}
        assert whole["ways"] == {"robot/r1": [0.0, 0.0, 1.0, 2.0]}
        assert change == {"t": 10.1, "set": {"robot/r1": {"at": [1, 3]}}}
        feed.close()
        assert await page.take() == b""

    asyncio.run(run())


def test_a_still_site_is_told_from_a_silent_server() -> None:
    async def run() -> None:
        feed = Feed()
        feed.update({"a": {"x": 1}}, 10.0)
        page = feed.join({})
        await page.take()
        for tenth in range(1, 25):
            feed.update({}, 10.0 + 0.1 * tenth)
        assert [one["t"] for one in messages(await page.take())] == [11.0, 12.0]

    asyncio.run(run())


def test_a_page_that_does_not_read_is_dropped_and_the_others_get_everything() -> None:
    async def run() -> None:
        feed = Feed()
        slow, quick = feed.join({}), feed.join({})
        got = []
        for number in range(2 * MOST_WAITING):
            feed.update({"a": {"x": number}}, 10.0 + number)
            got += messages(await quick.take())
        assert feed.dropped == 1
        assert feed.pages == 1
        assert await slow.take() == b""
        assert [one["set"]["a"]["x"] for one in got[1:]] == list(range(2 * MOST_WAITING))

    asyncio.run(run())


def test_no_more_pages_are_served_than_is_said() -> None:
    async def run() -> None:
        feed = Feed()
        pages = [feed.join({}) for _ in range(MOST_PAGES)]
        with pytest.raises(OperationError, match="close one"):
            feed.join({})
        feed.leave(pages[0])
        feed.join({})

    asyncio.run(run())
