"""The page of `look`: what its addresses give, and what a browser draws of it."""

import http.client
import json
import math
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from playwright.sync_api import Browser, expect, sync_playwright
from support.builders import eventually
from support.pictures.boards import charuco, picture_of, placed, target_of, true_pixels

from trigpoint.site.config import CameraConfig
from trigpoint.tools.look.looking import Look, Wishes
from trigpoint.tools.look.page import MOST_PAGES, Moments, page_served
from trigpoint.tools.look.shown import Shown

CHROMIUM = shutil.which("chromium")
PATIENCE_MS = 120_000
VIEW = placed(charuco(), x=-0.1, y=0.05, distance=0.8, tilt_deg=20)


@pytest.fixture
def moments() -> Moments:
    return Moments()


@pytest.fixture
def address(moments: Moments) -> Iterator[str]:
    with page_served(moments, 0) as served:
        yield served


@pytest.fixture(scope="module")
def moment(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shown, np.ndarray]:
    """A moment of looking at the board."""
    folder = tmp_path_factory.mktemp("moment")
    cv2.imwrite(str(folder / "0.png"), picture_of([VIEW], noise=1.0))
    told: list[tuple[Shown, np.ndarray]] = []
    wishes = Wishes(CameraConfig(f"dir://{folder}"), target_of(charuco()), out=folder / "c1.yaml")
    Look(wishes, lambda shown, picture: told.append((shown, picture))).run()
    return told[0]


def connected(address: str) -> http.client.HTTPConnection:
    return http.client.HTTPConnection("127.0.0.1", urlsplit(address).port or 0, timeout=20)


def asked(address: str, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = connected(address)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer


@contextmanager
def events(address: str) -> Iterator[Iterator[dict]]:
    connection = connected(address)
    try:
        connection.request("GET", "/events")
        lines = iter(connection.getresponse().readline, b"")
        yield (json.loads(line[6:]) for line in lines if line.startswith(b"data: {"))
    finally:
        connection.close()


def test_a_page_is_given_the_newest_moment_and_its_picture(
    moments: Moments, address: str, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    for number in range(3):
        moments.show(replace(shown, number=number, stamp=str(number)), picture)
    with events(address) as told:
        first = next(told)
        assert first["number"] == 2
        moments.show(replace(shown, number=7, stamp="7"), picture)
        assert next(told)["number"] == 7
    connection = connected(address)
    connection.request("GET", "/picture/7")
    drawn = cv2.imdecode(np.frombuffer(connection.getresponse().read(), np.uint8), 0)
    assert drawn is not None
    connection.close()
    assert np.abs(drawn.astype(int) - picture).mean() < 5
    assert first["faces"][0]["pixels"][:2] == pytest.approx(true_pixels(VIEW)[0], abs=0.3)
    assert sum(first["coverage"]) == 12
    assert ["lens", "not known yet"] in first["facts"]


def test_a_page_that_does_not_read_misses_moments_and_gets_the_last(
    moments: Moments, address: str, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    long = replace(shown, hints=["x" * 400_000])
    with events(address) as told:
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
        moments.show(shown, picture)
        ready = threading.Event()

        def listen() -> None:
            with events(address) as messages:
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
    moments: Moments, address: str, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    for number in range(9):
        moments.show(replace(shown, stamp=str(number)), picture)
    assert asked(address, "/picture/0").status == 404
    assert asked(address, "/picture/..%2f..%2fetc").status == 404
    assert asked(address, "/look.py").status == 404
    assert asked(address, "/", Host="evil.example").status == 421
    front = asked(address, "/")
    assert front.status == 200
    assert "frame-ancestors 'none'" in (front.getheader("Content-Security-Policy") or "")


def test_pages_are_bounded_and_a_place_is_free_again_when_one_goes(
    moments: Moments, address: str, moment: tuple[Shown, np.ndarray]
) -> None:
    moments.show(*moment)
    open_pages = [connected(address) for _ in range(MOST_PAGES)]
    for connection in open_pages:
        connection.request("GET", "/events")
        assert connection.getresponse().status == 200
    assert asked(address, "/events").status == 503
    for connection in open_pages:
        connection.close()

    def is_free() -> bool:
        connection = connected(address)
        connection.request("GET", "/events")
        status = connection.getresponse().status
        connection.close()
        return status == 200

    assert eventually(is_free)


@pytest.fixture
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"], timeout=PATIENCE_MS
        )
        yield opened
        opened.close()


@pytest.mark.skipif(
    CHROMIUM is None, reason="there is no Chromium here; install Debian's package «chromium»"
)
@pytest.mark.timeout(4 * PATIENCE_MS / 1000)
def test_corners_are_drawn_where_they_are_and_advice_is_said(
    browser: Browser, moments: Moments, address: str, moment: tuple[Shown, np.ndarray]
) -> None:
    shown, picture = moment
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(PATIENCE_MS)
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(address)
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
    page.close()
    narrow = browser.new_page(viewport={"width": 390, "height": 844})
    narrow.goto(address)
    narrow.wait_for_selector("#facts dd")
    assert narrow.evaluate("document.documentElement.scrollWidth") == 390
    narrow.close()
