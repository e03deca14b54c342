"""Reads HTML pages in tests."""

from html.parser import HTMLParser

VOID = {"meta", "br"}
FOREIGN = {"script", "link", "img", "iframe", "object", "use"}
NUMBERS = {"points", "x", "y", "cx", "cy", "r", "x1", "y1", "x2", "y2", "width", "height"}


class PageReader(HTMLParser):
    """Checks that every element is closed in its place, that nothing comes from elsewhere, and that
    drawings' numbers are some; collects tags, attributes and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.attributes: list[tuple[str, str]] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in FOREIGN
        self.tags.add(tag)
        for name, given in attrs:
            value = given or ""
            assert name not in ("src", "onclick", "onload"), value
            assert name != "href" or value.startswith("data:"), value
            assert name not in NUMBERS or not ("nan" in value or "inf" in value), (name, value)
            self.attributes.append((name, value))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def read_page(page: str) -> PageReader:
    """A whole page; fails where an element is left open or anything is fetched."""
    assert not any(word in page for word in ("url(", "@import", "http"))
    reader = PageReader()
    reader.feed(page)
    assert reader.open == []
    return reader
