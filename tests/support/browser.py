"""Pages in headless Chromium. Tests that take `browser` have both marks."""

import shutil
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

CHROMIUM = shutil.which("chromium")
PATIENCE_MS = 120_000  # it takes a second, but a busy machine far more
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="there is no Chromium here; install Debian's package «chromium»"
)
is_patient = pytest.mark.timeout(4 * PATIENCE_MS / 1000)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"], timeout=PATIENCE_MS
        )
        yield opened
        opened.close()


@pytest.fixture
def browser(chromium: Browser) -> Iterator[Browser]:
    """One browser for all tests; what a test opens, with its memory, is closed behind it."""
    yield chromium
    for context in chromium.contexts:
        context.close()


def opened(browser: Browser, address: str, **settings: object) -> tuple[Page, list[str]]:
    """A page, and what its console says."""
    page = browser.new_page(**settings)  # pyright: ignore
    page.set_default_timeout(PATIENCE_MS)
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(address)
    return page, said
