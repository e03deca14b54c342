"""What pages and sources say of other pages leads somewhere."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("decisions/*.md")]
_ROOMS = ("benchmarks", "edge", "fusion", "native", "recorder", "robot", "tests", "tools")
_SUFFIXES = {".py", ".md", ".c", ".h", ".hpp", ".cpp", ".ino", ".toml", ".svg"}


def test_every_link_of_a_page_leads_somewhere() -> None:
    broken = [
        f"{page.relative_to(ROOT)}: {link}"
        for page in PAGES
        for link in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
        if "://" not in link and not (page.parent / link).exists()
    ]
    assert not broken


def test_every_page_that_a_source_names_is_there() -> None:
    places = [ROOT / "Makefile", *ROOT.glob("*.md"), *ROOT.glob("docs/**/*.*")]
    for room in (*_ROOMS, "trigpoint"):
        places += [path for path in (ROOT / room).rglob("*.*") if path.suffix in _SUFFIXES]
    named = {
        name
        for place in places
        if place.suffix != ".png"
        for name in re.findall(r"\bdocs/[\w/-]+\.\w+", place.read_text(encoding="utf-8"))
    }
    assert named
    assert [name for name in sorted(named) if not (ROOT / name).is_file()] == []


def test_the_index_has_every_decision_by_its_title() -> None:
    rows = (ROOT / "decisions/README.md").read_text(encoding="utf-8")
    found = re.findall(
        r"^\| (\d{4}) \| \[(.+)\]\((.+)\) \| (?:in force|superseded|tried)", rows, re.M
    )
    expected = []
    for path in sorted((ROOT / "decisions").glob("[0-9]*.md")):
        first, *_ = path.read_text(encoding="utf-8").splitlines()
        title = re.sub(r"^# (\d{4}:? )?", "", first)
        expected.append((path.name[:4], title[0].upper() + title[1:], path.name))
    assert found == expected


def test_the_docs_index_has_every_page() -> None:
    index = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    pages = {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").glob("**/*.md")}
    assert {page for page in pages if f"({page})" not in index} == {"README.md"}
