"""What every page has: the document around its sections, their parts, tables and figures."""

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from .svg import element

_MARK = (
    '<svg viewBox="0 0 24 24" aria-hidden="true"><path d="M12 3 L21 20 L3 20 Z"/>'
    '<circle cx="12" cy="14.4" r="2.4"/></svg>'
)
_MOST_IN_A_ROW = 5


def html_page(title: str, *sections: str, headline: str, lead: str, footer: str) -> str:
    """A whole document, self-contained: no script, no picture, no font from anywhere.

    `sections`: markup; the others are words.
    """
    head = element(
        "head",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        element("title", escape(title)),
        element("style", Path(__file__).with_name("style.css").read_text("utf-8")),
    )
    header = element(
        "header",
        element("div", _MARK, element("span", "Trigpoint"), class_="brand"),
        element("h1", escape(headline)),
        element("p", escape(lead), class_="lead"),
    )
    main = element("main", header, *sections, element("footer", escape(footer)))
    return f'<!doctype html>\n<html lang="en">{head}<body>{main}</body></html>\n'


def section(title: str, *content: str) -> str:
    """A part of a page below its title; `content`: markup."""
    return element("section", element("h2", title), *content)


def note(words: str) -> str:
    return element("p", escape(words), class_="note")


def warning(title: str, items: Iterable[str]) -> str:
    """A list of what is wrong, each `items` markup; "" where nothing is."""
    shown = [element("li", item) for item in items]
    if not shown:
        return ""
    return element("div", element("b", title), element("ul", *shown), class_="failures")


def tiles(*shown: str) -> str:
    """Tiles beside each other, without those that are ""."""
    told = [one for one in shown if one]
    kind = "tiles thirds" if len(told) > _MOST_IN_A_ROW else "tiles"
    return element("div", *told, class_=kind)


def tile(number: str, words: str, *, is_bad: bool = False) -> str:
    kind = "tile bad" if is_bad else "tile"
    return element("div", element("b", escape(number)), element("span", escape(words)), class_=kind)


def row(cells: Iterable[str], *, class_: str | None = None) -> str:
    """A table's row of markup."""
    return element("tr", *(element("td", cell) for cell in cells), class_=class_)


def table(head: Sequence[str], rows: Iterable[str]) -> str:
    """A table; `head`: markup of its cells."""
    cells = element("tr", *(element("th", cell) for cell in head))
    return element("table", element("thead", cells), element("tbody", *rows))


def scrolling(shown: str, *, narrow: bool = False) -> str:
    """What may be wider than a small screen."""
    return element("div", shown, class_="scroll narrow" if narrow else "scroll")


def wide_and_upright(wide: str, upright: str, key: str) -> str:
    """A drawing for large screens and one for small, with what its marks mean."""
    drawings = element("div", wide, class_="wide") + element("div", upright, class_="upright")
    return element("figure", drawings, key, class_="card")


def legend(entries: Iterable[tuple[str, str]]) -> str:
    """What marks mean: each mark, markup within 34 × 14, with its words."""
    shown = [
        element(
            "li",
            element("svg", mark, viewBox="0 0 34 14", aria_hidden="true", class_="k0"),
            element("span", escape(words)),
        )
        for mark, words in entries
    ]
    return element("ul", *shown, class_="legend")


def commands(rows: Sequence[tuple[str, str]]) -> str:
    """Commands to type, each with what it does behind it."""
    width = max(len(command) for command, _ in rows)
    lines = "\n".join(f"{command:<{width}}  # {what}" for command, what in rows)
    return element("pre", escape(lines))


def centimetres(metres: float) -> str:
    """A short length for people."""
    return f"{100 * metres:.2f} cm" if metres < 0.1 else f"{100 * metres:.1f} cm"


def fixed(value: float, digits: int) -> str:
    """Without a minus before zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"
