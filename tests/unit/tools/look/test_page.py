"""The page of `look`: what its addresses give, and what a browser draws of it."""

import math
import threading
from collections.abc import Iterator
from contextlib import suppress

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from playwright.sync_api import Browser, expect
from support.browser import browser, chromium, is_patient, needs_chromium, opened
from support.builders import eventually
from support.pictures.boards import charuco, picture_of, placed, target_of, true_pixels
from support.site.visitor import Visitor

from trigpoint.site.config import CameraConfig
from trigpoint.tools.look.looking import Look, Wishes
from trigpoint.tools.look.page import MOST_PAGES, Moments, page_served
from trigpoint.tools.look.shown import Shown

__all__ = ["browser", "chromium"]  # the fixtures

VIEW = placed(charuco(), x=-0.1, y=0.05, distance=0.8, tilt_deg=20)


@pytest.fixture
def moments() -> Moments:
    return Moments()


@pytest.fixture
def visitor(moments: Moments) -> Iterator[Visitor]:
    with page_served(moments, 0) as address:
        yield Visitor(address)


@pytest.fixture(scope="module")
def moment(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shown, np.ndarray]:
    """A moment of looking at the board."""
    folder = tmp_path_factory.mktemp("moment")
    cv2.imwrite(str(folder / "0.png"), picture_of([VIEW], noise=1.0))
    told: list[tuple[Shown, np.ndarray]] = []
    wishes = Wishes(CameraConfig(f"dir://{folder}"), target_of(charuco()), out=folder / "c1.yaml")
    Look(wishes, lambda shown, picture: told.append((shown, picture))).run()
    return told[0]


def test_a_page_is_given_the_newest_moment_and_its_picture(
    moments: Moments, visitor: Visitor, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    for number in range(3):
        moments.show(replace(shown, number=number, stamp=str(number)), picture)
    with visitor.events() as told:
        first = next(told)
        assert first["number"] == 2
        moments.show(replace(shown, number=7, stamp="7"), picture)
        assert next(told)["number"] == 7
    drawn = cv2.imdecode(np.frombuffer(visitor.ask("/picture/7").body, np.uint8), 0)
    assert drawn is not None
    assert np.abs(drawn.astype(int) - picture).mean() < 5
    assert first["faces"][0]["pixels"][:2] == pytest.approx(true_pixels(VIEW)[0], abs=0.3)
    assert sum(first["coverage"]) == 12
    assert ["lens", "not known yet"] in first["facts"]


def test_a_page_that_does_not_read_misses_moments_and_gets_the_last(
    moments: Moments, visitor: Visitor, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    long = replace(shown, hints=["x" * 400_000])
    with visitor.events() as told:
        moments.show(shown, picture)
        assert next(told)["number"] == shown.number
        for number in range(60):
            moments.show(replace(long, number=number, stamp=str(number)), picture)
        numbers = []
        while not numbers or numbers[-1] != 59:
            numbers.append(next(told)["number"])
    assert numbers == sorted(numbers)


def test_the_last_moment_reaches_a_page_before_the_server_goes(
    moment: tuple[Shown, np.ndarray],
) -> None:
    moments = Moments()
    shown, picture = moment
    told: list[dict] = []
    with page_served(moments, 0) as address:
        visitor = Visitor(address)
        moments.show(shown, picture)
        ready = threading.Event()

        def listen() -> None:
            with visitor.events() as messages:
                for message in messages:
                    told.append(message)
                    ready.set()

        thread = threading.Thread(target=listen)
        thread.start()
        assert ready.wait(20)
        moments.show(replace(shown, over="it has ended"), picture)
    thread.join()
    assert told[-1]["over"] == "it has ended"


def test_old_pictures_and_paths_are_not_found_and_all_answers_are_guarded(
    moments: Moments, visitor: Visitor, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    for number in range(9):
        moments.show(replace(shown, stamp=str(number)), picture)
    assert visitor.ask("/picture/0").status == 404
    assert visitor.ask("/picture/..%2f..%2fetc").status == 404
    assert visitor.ask("/look.py").status == 404
    assert visitor.ask("/", Host="evil.example").status == 421
    front = visitor.ask("/")
    assert front.status == 200
    assert "frame-ancestors 'none'" in front.headers["content-security-policy"]


def test_pages_are_bounded_and_a_place_is_free_again_when_one_goes(
    moments: Moments, visitor: Visitor, moment: tuple[Shown, np.ndarray]
) -> None:
    moments.show(*moment)
    open_pages = [visitor.connected() for _ in range(MOST_PAGES)]
    for connection in open_pages:
        connection.request("GET", "/events")
        assert connection.getresponse().status == 200
    assert visitor.ask("/events").status == 503
    for connection in open_pages:
        connection.close()

    def is_free() -> bool:
        with suppress(AssertionError), visitor.events():
            return True
        return False

    assert eventually(is_free)


@needs_chromium
@is_patient
def test_corners_are_drawn_where_they_are_and_advice_is_said(
    browser: Browser, moments: Moments, visitor: Visitor, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    page, said = opened(browser, visitor.address, viewport={"width": 1280, "height": 900})
    moments.show(replace(shown, hints=["write columns = 9"]), picture)
    page.wait_for_selector("#corners path", state="attached")
    expect(page.locator("#advice")).to_have_text(shown.advice)
    expect(page.locator("#hints")).to_have_text("write columns = 9")
    expect(page.locator("#link")).to_have_text("live")
    at = page.evaluate(
        """() => {
          const d = document.querySelector("#corners path").getAttribute("d");
          const [, x, y, arm] = /^M([-\\d.]+) ([-\\d.]+)h([-\\d.]+)/.exec(d).map(Number);
          const drawing = document.getElementById("over").getScreenCTM();
          const seen = new DOMPoint(x + arm / 2, y).matrixTransform(drawing);
          const box = document.getElementById("picture").getBoundingClientRect();
          const x1 = (seen.x - box.x) / box.width, y1 = (seen.y - box.y) / box.height;
          return [x1 * 640 - 0.5, y1 * 480 - 0.5];
        }"""
    )
    assert math.dist(at, true_pixels(VIEW)[0]) < 1
    assert page.locator("#map rect:not(.next)").count() == 81
    assert page.locator("#needs li").count() == 15
    moments.show(replace(shown, over="it has ended; the lens is in c1.yaml"), picture)
    expect(page.locator("#advice")).to_have_text("it has ended; the lens is in c1.yaml")
    expect(page.locator("#link")).to_have_text("ended")
    assert said == []
    narrow, _ = opened(browser, visitor.address, viewport={"width": 390, "height": 844})
    narrow.wait_for_selector("#facts dd")
    assert narrow.evaluate("document.documentElement.scrollWidth") == 390
