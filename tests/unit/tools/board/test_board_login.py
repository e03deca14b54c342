"""One logs in as a browser does it, whose rules of cookies and origins no plain request has."""

import pytest
from playwright.sync_api import Browser, expect
from support.browser import browser, chromium, is_patient, needs_chromium, opened
from support.builders import make_site
from support.site.board_desk import served_board

from trigpoint.tools.web.access import Access

__all__ = ["browser", "chromium"]  # the fixtures

pytestmark = [needs_chromium, is_patient]


def test_who_has_the_word_comes_in(browser: Browser, monkeypatch: pytest.MonkeyPatch) -> None:
    token = 8 * "word"
    with served_board(make_site(), monkeypatch, access=Access(token=token)) as desk:
        page, _ = opened(browser, f"{desk.address}?kiosk")
        page.locator("#token").fill(token[1:])
        page.keyboard.press("Enter")
        expect(page.get_by_role("alert")).to_have_text("That is not the word.")
        page.locator("#token").fill(token)
        page.get_by_role("button", name="Log in").click()
        expect(page.locator("#site")).to_have_text("lab")
        expect(page.locator("body.kiosk")).to_have_count(1)  # what was asked for
