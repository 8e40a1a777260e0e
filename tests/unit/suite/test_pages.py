"""The pages: every link leads somewhere, every file they name exists, every page is in the index."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
README_LINES_MAX = 130
LINK = re.compile(r"\]\((?!https?:)([^)\s]*)\)")
FILE = re.compile(r"`((?:flightstack|bridge|sim|logs|tests|docs|examples)/[\w./*-]*)`")
TERM = re.compile(r"^\| .+ \| `([\w/.]+)`(?:: `(\w+)`)? \|$", re.MULTILINE)


def anchors(page):
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def prose(page):
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_files_of_a_page_exist(page):
    for link in LINK.findall(prose(page)):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link
    for name in FILE.findall(prose(page)):
        assert list(ROOT.glob(name.rstrip("/"))), name


def test_the_index_names_every_page():
    named = {
        (DOCS / link.partition("#")[0]).resolve() for link in LINK.findall((DOCS / "README.md").read_text())
    }
    assert {page for page in PAGES if page.parent != ROOT} - named == {DOCS / "README.md"}


def test_the_readme_is_short_and_opens_with_a_landing():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= README_LINES_MAX
    assert text.splitlines()[2].startswith("![")
    assert "tests.benchmarks landing_figure" in text
    assert 10_000 < (DOCS / "figures" / "landing.svg").stat().st_size < 150_000


def test_every_term_of_the_glossary_is_where_it_says():
    terms = TERM.findall((DOCS / "glossary.md").read_text())
    assert len(terms) > 50
    for file, name in terms:
        assert re.search(rf"\b{name}\b", (ROOT / file).read_text()), (file, name)
