"""Reads HTML pages in tests."""

from html.parser import HTMLParser

VOID = {"meta", "br"}


class PageReader(HTMLParser):
    """Checks that every element is closed in its place, and collects tags, attributes and text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.attributes: list[tuple[str, str]] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] != "style":
            self.words.append(data)


def read_page(text: str) -> PageReader:
    """A whole page; fails where an element is left open."""
    reader = PageReader()
    reader.feed(text)
    assert reader.open == []
    return reader
