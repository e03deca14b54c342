"""What a browser draws of a live site, looked at in headless Chromium against the truth."""

import io
import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect
from support.browser import PATIENCE_MS, browser, chromium, is_patient, needs_chromium
from support.browser import opened as opened_page
from support.builders import make_site, site_text
from support.site.board_desk import Desk, served_board
from support.site.board_site import BoardSite, Truth, run

from trigpoint.contract import topics
from trigpoint.contract.messages import Picture
from trigpoint.contract.topics import command_key
from trigpoint.site.config import Site, parse_site

__all__ = ["browser", "chromium"]  # the fixtures

TRUTH = Truth(9, 3, is_still=True)
UNLOCATED, UNSEEN = 1, 2

pytestmark = [needs_chromium, is_patient]
PLACE = """([layer, name]) => {
  const mark = document.querySelector(`#${layer} [data-id="${name}"]`);
  const at = new DOMPoint(0, 0).matrixTransform(mark.getScreenCTM());
  const map = document.getElementById("map").getScreenCTM().inverse();
  const ahead = new DOMPoint(1, 0).matrixTransform(mark.firstElementChild.getScreenCTM());
  const metres = at.matrixTransform(map);
  return [at.x, at.y, metres.x, -metres.y, Math.atan2(at.y - ahead.y, ahead.x - at.x)];
}"""
"""Where a mark is on the screen, in the map, and which way it points: as it is laid out."""


DRAG = """([x, y]) => {
  const map = document.getElementById("map");
  for (const [kind, way] of [["down", 0], ["move", 1], ["up", 1]]) {
    const at = { clientX: 300 + way * x, clientY: 300 + way * y };
    const finger = { pointerType: "touch", isPrimary: true, bubbles: true, ...at };
    map.dispatchEvent(new PointerEvent(`pointer${kind}`, finger));
  }
}"""
"""A finger that goes so many pixels over the map."""


def opened(browser: Browser, address: str, **settings: object) -> tuple[Page, list[str]]:
    """A page that shows robots, and what its console has said."""
    page, said = opened_page(browser, address, **settings)
    wait_until_drawn(page)
    return page, said


def wait_until_drawn(page: Page) -> None:
    page.wait_for_selector('#robots [data-id="robot/r3"]')
    page.wait_for_selector('#cameras [data-id="camera/c9"].located')


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    site = make_site(cameras=9, robots=3)
    with served_board(site, monkeypatch) as served, published(served, site):
        yield served


class published:  # noqa: N801 - reads as a word of the `with` line
    """A thread that publishes the site; `.site` is what it publishes."""

    def __init__(self, desk: Desk, site: Site) -> None:
        self._bus = desk.broker.session()
        self.site = BoardSite(
            self._bus,
            site,
            TRUTH,
            unlocated=frozenset({UNLOCATED}),
            unseen=frozenset({UNSEEN}),
        )
        self._over = threading.Event()
        self._thread = threading.Thread(
            target=run, args=(self.site, time.time, self._over.is_set), name="published"
        )

    def __enter__(self) -> BoardSite:
        self._thread.start()
        return self.site

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._bus.close()


def assert_places(page: Page) -> None:
    """Marks are where the truth is, point as it does, and lie within the map on the screen."""
    wait_until_drawn(page)
    box = page.locator("#map").bounding_box()
    assert box is not None
    for index in range(TRUTH.robots):
        x, y, heading = TRUTH.robot(index, 0.0)
        found = page.evaluate(PLACE, ["robots", f"robot/r{index + 1}"])
        assert math.hypot(found[2] - x, found[3] - y) < 2e-3
        assert abs(math.remainder(found[4] - heading, 2 * math.pi)) < 0.01
        assert box["x"] < found[0] < box["x"] + box["width"]
        assert box["y"] < found[1] < box["y"] + box["height"]
    for index in set(range(TRUTH.cameras)) - {UNLOCATED, UNSEEN}:
        pose = TRUTH.camera(index)
        found = page.evaluate(PLACE, ["cameras", f"camera/c{index + 1}"])
        assert math.hypot(*(found[2:4] - pose.translation[:2])) < 2e-3
        azimuth = math.atan2(pose.rotation[1, 2], pose.rotation[0, 2])
        assert abs(math.remainder(found[4] - azimuth, 2 * math.pi)) < 0.01


def cells(page: Page, table: str, name: str) -> list[str]:
    return page.locator(f'#{table} [data-id="{name}"] td').all_inner_texts()


def test_what_is_drawn_is_where_the_truth_is_and_the_tables_say_the_same(
    browser: Browser, desk: Desk
) -> None:
    page, said = opened(browser, desk.address, viewport={"width": 1440, "height": 900})
    expect(page.locator("#link")).to_have_text("live", timeout=PATIENCE_MS)
    page.wait_for_selector('#node-table [data-id="node/edge/c9"]')
    assert_places(page)
    x, y, heading = TRUTH.robot(0, 0.0)
    robot = cells(page, "robot-table", "robot/r1")
    assert robot[:2] == ["r1", f"{x:.2f}, {y:.2f}"]
    assert robot[4] == f"{round(math.degrees(heading)) % 360}°"
    first = page.locator('#camera-table [data-id="camera/c1"] td')
    expect(first.nth(3)).to_have_text("live", timeout=PATIENCE_MS)  # tables take turns
    assert first.all_inner_texts()[1:3] == ["located", "±2.4 cm"]
    assert cells(page, "camera-table", "camera/c2")[1] == "undetermined"
    assert cells(page, "camera-table", "camera/c3")[1] == "unseen"
    assert page.locator("#absent").inner_text() == "Not on the map: c2 (undetermined), c3 (unseen)"
    assert page.locator('#floors [data-id="camera/c1"]').get_attribute("d")
    assert page.locator('#cameras [data-id="camera/c2"]').count() == 0
    assert page.locator("#counts").inner_text().split("\n")[0] == "7 / 9 cameras located"
    ellipse = page.locator("#robot-ellipses ellipse").first
    assert float(ellipse.get_attribute("rx") or 0) > float(ellipse.get_attribute("ry") or 0) > 0
    assert page.locator('#ways [data-id="robot/r1"]').get_attribute("d")
    assert said == []


def test_the_map_is_moved_by_keys_and_stays_true(browser: Browser, desk: Desk) -> None:
    page, _ = opened(browser, desk.address, viewport={"width": 1440, "height": 900})
    before = page.evaluate(PLACE, ["robots", "robot/r1"])
    page.locator("#map").focus()
    page.keyboard.press("+")
    page.keyboard.press("ArrowLeft")
    after = page.evaluate(PLACE, ["robots", "robot/r1"])
    assert math.hypot(after[0] - before[0], after[1] - before[1]) > 20
    assert after[2:4] == pytest.approx(before[2:4], abs=2e-3)
    page.evaluate(DRAG, [30, 40])
    dragged = page.evaluate(PLACE, ["robots", "robot/r1"])
    assert dragged[:2] == pytest.approx([after[0] + 30, after[1] + 40], abs=1)
    page.keyboard.press("0")
    page.evaluate(DRAG, [30, 40])  # a finger moves the page where all of the map is seen
    assert page.evaluate(PLACE, ["robots", "robot/r1"])[:2] == pytest.approx(before[:2], abs=1)


@pytest.mark.parametrize("width", [390, 820])
def test_on_a_phone_nothing_is_wider_than_the_screen(
    browser: Browser, desk: Desk, width: int
) -> None:
    page, _ = opened(browser, desk.address, viewport={"width": width, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert_places(page)


def test_it_is_dark_where_that_is_wanted(browser: Browser, desk: Desk) -> None:
    for scheme, is_dark in (("light", False), ("dark", True)):
        page, _ = opened(browser, desk.address, color_scheme=scheme)
        picture = Image.open(io.BytesIO(page.screenshot(timeout=PATIENCE_MS))).convert("L")
        histogram = picture.histogram()
        dark = sum(histogram[:60]) / sum(histogram)
        assert (dark > 0.7) == is_dark, dark
        page.close()


def test_a_wall_shows_what_matters_without_a_hand(browser: Browser, desk: Desk) -> None:
    page, _ = opened(browser, f"{desk.address}?kiosk", viewport={"width": 1920, "height": 1080})
    assert page.evaluate("document.documentElement.scrollHeight") <= 1080
    page.wait_for_selector('#camera-table [data-id="camera/c9"].fine', state="attached")
    assert page.locator("#camera-table tbody tr:visible").count() == 2  # c2 and c3
    assert not page.locator("#past").is_visible()
    assert_places(page)
    heights = page.evaluate(
        """() => {
          const rows = [...document.querySelectorAll("#camera-table tbody tr")];
          const height = () => document.getElementById("camera-table").offsetHeight;
          const before = height();
          rows.forEach((row) => row.classList.add("fine"));
          return [before, height()];
        }"""
    )
    assert heights[0] > 0 == heights[1]  # where all is fine there is no table of nothing


def test_alarms_are_said_in_words_with_their_times(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = make_site(cameras=9, robots=3)
    with served_board(lab, monkeypatch) as desk, published(desk, lab) as site:
        page, _ = opened(browser, desk.address)
        page.wait_for_selector("#alarms .none")
        site.troubles["edge/c4"] = "the picture has not changed for 12 s"
        text = page.locator("#alarms .error span")
        text.wait_for()
        assert text.inner_text() == "edge/c4: the picture has not changed for 12 s"
        assert page.locator("#news").inner_text() == text.inner_text()
        assert page.locator("#news").get_attribute("role") == "alert"
        assert "since" in page.locator("#alarms .error small").inner_text()
        assert "1 alarm" in page.title()
        del site.troubles["edge/c4"]
        page.wait_for_selector("#alarms .over")
        assert page.locator("#alarms .none").count() == 1


def test_errors_come_before_later_warnings_and_words_are_right_at_their_edges(
    browser: Browser, desk: Desk
) -> None:
    page, _ = opened(browser, desk.address)
    said = page.evaluate(
        """async () => {
          const { Tables, degrees, spoken } = await import("/tables.js");
          const tables = new Tables(() => {});
          tables.show("alarm/1", { node: "a", text: "down", state: "error", since: 1 });
          tables.show("alarm/2", { node: "b", text: "slow", state: "warning", since: 9 });
          tables.alarms(10);
          tables.show("node/a", { state: "ok", lost: 1 });
          tables.counts();
          tables.show("site", { started: 4 });
          const ages = [tables.ago(8, 10), tables.ago(0, 10)];
          const lost = document.querySelector("#counts li:last-child").textContent;
          const alarms = [...document.querySelectorAll("#alarms span")];
          const texts = alarms.slice(0, 2).map((one) => one.textContent);
          const edges = [spoken(7190), spoken(89.6), degrees(-0.004), degrees(-Math.PI / 2)];
          return [lost, ages, texts, ...edges];
        }"""
    )
    assert said.pop(0) == "1 message or picture lost"
    assert said.pop(0) == ["2 s ago", "not for 6 s"]  # what was before its start no page knows
    assert said == [["a: down", "b: slow"], "2 h 0 min", "2 min", "0°", "270°"]


def test_a_robot_that_is_silent_greys(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> None:
    lab = make_site(cameras=9, robots=3)
    with served_board(lab, monkeypatch) as desk:
        with published(desk, lab):
            page, _ = opened(browser, desk.address)
            assert page.locator('#robots [data-id="robot/r1"].stale').count() == 0
        page.wait_for_selector('#robots [data-id="robot/r1"].stale')
        expect(page.locator("#robot-table")).to_contain_text("(stale)", timeout=PATIENCE_MS)
        pictures = page.locator('#camera-table [data-id="camera/c1"] td').nth(3)
        expect(pictures).to_have_text("–", timeout=PATIENCE_MS)  # its agent says nothing any more
        assert_places(page)


def test_a_camera_whose_agent_is_gone_greys_though_its_place_is_known(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = make_site(cameras=9, robots=3)
    with served_board(lab, monkeypatch) as desk, published(desk, lab) as site:
        page, said = opened(browser, desk.address)
        site.end("edge/c4")
        page.wait_for_selector('#cameras [data-id="camera/c4"].located.stale')
        page.wait_for_selector('#camera-table [data-id="camera/c4"].stale')
        assert page.locator("#cameras .stale, #camera-table tr.stale").count() == 2
        assert said == []


def test_it_comes_back_by_itself_when_the_server_does(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = make_site(cameras=9, robots=3)
    with served_board(lab, monkeypatch) as desk, published(desk, lab):
        page, _ = opened(browser, desk.address)
        port = desk.port
    page.wait_for_selector("body.cut")
    assert "no news from the board's server" in page.locator("#link").inner_text()
    page.wait_for_selector("#alarms .error")  # not «All is well.»
    assert "no news from the board's server" in page.locator("#alarms").inner_text()
    assert "no news from the board's server" in page.title()
    with served_board(lab, monkeypatch, port=port) as desk, published(desk, lab):
        page.wait_for_selector("body:not(.cut)")
        expect(page.locator("#link")).to_have_text("live", timeout=PATIENCE_MS)
        assert_places(page)


def test_the_last_hour_is_scrubbed_back(browser: Browser, desk: Desk) -> None:
    page, _ = opened(browser, desk.address)
    page.wait_for_timeout(4000)
    page.locator("#when").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    page.wait_for_selector("body.past")
    assert page.locator("#link").inner_text().startswith("as it was at")
    assert "2 s ago" in page.locator("#then").inner_text()
    page.wait_for_selector('#robots [data-id="robot/r3"]')
    assert_places(page)
    page.locator("#now").click()
    assert page.evaluate("document.activeElement.id") == "when"
    page.wait_for_selector("body:not(.past)")
    assert_places(page)


def test_a_cameras_picture_is_shown_with_what_was_found(browser: Browser, desk: Desk) -> None:
    page, said = opened(browser, desk.address)
    data = io.BytesIO()
    Image.new("RGB", (640, 480), (40, 90, 40)).save(data, "jpeg")
    over = threading.Event()
    with desk.broker.session() as bus:
        site = BoardSite(bus, make_site(cameras=9, robots=3), TRUTH)

        def send() -> None:
            while not over.wait(0.1):
                now_s = round(time.time(), 3)
                site.put(
                    topics.IMAGE, "c1", Picture(round(1e9 * now_s), "", "jpeg", data.getvalue())
                )
                site.move(now_s)

        thread = threading.Thread(target=send)
        thread.start()
        try:
            page.get_by_role("button", name="c1", exact=True).click()
            page.wait_for_selector("#faces path")
            told = page.locator("#told").inner_text()
            assert told.startswith("1 face, 24 corners; taken at")
            assert page.evaluate("document.getElementById('picture').naturalWidth") == 640
            page.keyboard.press("Escape")
            assert not page.locator("#looking").is_visible()
        finally:
            over.set()
            thread.join()
    assert said == []


def test_a_new_map_is_asked_for_twice(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> None:
    lab, asked = make_site(cameras=9, robots=3), []
    with (
        served_board(lab, monkeypatch, is_operator=True) as desk,
        published(desk, lab),
        desk.broker.session() as bus,
    ):
        bus.serve(command_key("lab", "fusion/reset"), lambda _: asked.append(1) or b"{}")
        page, said = opened(browser, desk.address)
        begin, go = page.get_by_role("button", name="Begin a new map"), page.locator("#go")
        begin.click()
        page.get_by_role("button", name="Leave it").click()
        begin.click()
        go.click()
        expect(page.locator("#asked")).to_contain_text("Write the site's name")
        assert go.is_disabled()
        page.keyboard.press("Escape")
        assert asked == []
        begin.click()
        go.click()
        page.locator("#answer").press("Enter")  # without the name
        assert asked == []
        page.locator("#answer").fill("lab")
        page.locator("#answer").press("Enter")
        expect(page.locator("#asked")).to_have_text("A new map begins.")
        assert asked == [1]
        assert said == []


def test_the_floor_plan_lies_under_the_map(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = Image.new("L", (200, 100), 255)
    plan.putpixel((150, 20), 0)
    plan.save(tmp_path / "hall.png")
    (tmp_path / "hall.yaml").write_text(
        "image: hall.png\nresolution: 0.1\norigin: [-4, -1, 0]\n", encoding="utf-8"
    )
    text = site_text(cameras=9, robots=3, more='[map]\nplan = "hall.yaml"\norigin = [1, 2, 0.5]')
    lab = parse_site(text, directory=tmp_path)
    with served_board(lab, monkeypatch) as desk, published(desk, lab):
        page, said = opened(browser, desk.address)
        page.wait_for_selector("#plan image")
        found = page.evaluate(
            """() => {
              const map = document.getElementById("map").getScreenCTM().inverse();
              const image = document.querySelector("#plan image").getScreenCTM();
              const at = new DOMPoint(150.5, 20.5).matrixTransform(image).matrixTransform(map);
              return [at.x, -at.y];
            }"""
        )
        # The pixel's middle is (11.05, 6.95) in the building; the map lies there at (1, 2), turned.
        x, y = 11.05 - 1, 6.95 - 2
        turned = (math.cos(0.5) * x + math.sin(0.5) * y, math.cos(0.5) * y - math.sin(0.5) * x)
        assert found == pytest.approx(turned, abs=2e-3)
        assert page.evaluate("fetch('/plan.png').then((answer) => answer.status)") == 200
        assert said == []
