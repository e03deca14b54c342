"""What every page has: the document around its body, and the brand."""

from html import escape

from .style import STYLE
from .svg import element

_MARK = (
    '<svg viewBox="0 0 24 24" aria-hidden="true"><path d="M12 3 L21 20 L3 20 Z"/>'
    '<circle cx="12" cy="14.4" r="2.4"/></svg>'
)


def html_page(title: str, body: str) -> str:
    """A whole document; `body`: markup."""
    head = element(
        "head",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        element("title", escape(title)),
        element("style", STYLE),
    )
    return f'<!doctype html>\n<html lang="en">{head}<body>{body}</body></html>\n'


def brand() -> str:
    """The mark and the name."""
    return element("div", _MARK, element("span", "Trigpoint"), class_="brand")


def tile(number: str, words: str, *, is_bad: bool = False) -> str:
    """A number with what it means."""
    kind = "tile bad" if is_bad else "tile"
    return element("div", element("b", escape(number)), element("span", escape(words)), class_=kind)


def centimetres(metres: float) -> str:
    """A short length for people."""
    return f"{100 * metres:.2f} cm" if metres < 0.1 else f"{100 * metres:.1f} cm"
