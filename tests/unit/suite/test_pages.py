"""Tests the documentation: links and named files exist, the index has every page, the site builds."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from flightstack.config import load
from flightstack.verify.certificate import checks

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
LINK = re.compile(r"\]\((?!https?:)([^)\s]*)\)")
FILE = re.compile(r"`((?:flightstack|bridge|sim|logs|tests|docs|examples)/[\w./*-]*)`")


def anchors(page):
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def prose(page):
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


def test_the_configuration_for_a_turtlebot_is_proven(tmp_path):
    file = tmp_path / "turtlebot.toml"
    (text,) = re.findall(r"^```toml\n(.*?)^```", (DOCS / "how_to/ros2.md").read_text(), re.M | re.S)
    file.write_text(text)
    assert [check.name for check in checks(load(file)) if not check.proven] == []


@pytest.mark.slow
@pytest.mark.skipif(find_spec("mkdocs") is None, reason="the extra docs is not installed")
def test_the_site_builds_strictly(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", tmp_path / "site"],
        cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
        timeout=200, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    page = (tmp_path / "site" / "reference" / "library.html").read_text()
    assert "flightstack.api.landing.Landing" in page
