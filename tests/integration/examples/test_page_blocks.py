"""Tests the Python and TOML blocks of the documentation: programs run, and files can be read."""

import re
import tomllib
from pathlib import Path

import plotly.graph_objects as go
import pytest

from flightstack.config import load as load_config
from sim.scenarios.scenario import load as load_scenario

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(language):
    """Yield (page and number, text) for every block of a language."""
    for page in PAGES:
        found = re.findall(rf"^```{language}[^\n]*\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        yield from ((f"{page.relative_to(ROOT)}-{n}", text) for n, text in enumerate(found))


# other blocks need a vehicle; MAVSDK's program and the subscriber of a flight have their own tests
LIBRARY = {name: text for name, text in blocks("python") if "import flightstack as fs" in text}
TABLES = dict(blocks("toml"))


@pytest.mark.parametrize("name", LIBRARY)
def test_a_program_of_a_page_runs(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(go.Figure, "show", lambda figure: figure.to_json())
    exec(compile(LIBRARY[name], name, "exec"), {"__name__": "page"})


@pytest.mark.parametrize("name", TABLES)
def test_a_file_of_a_page_is_read(name, tmp_path):
    table = tomllib.loads(TABLES[name])
    assert table
    file = tmp_path / "page.toml"
    file.write_text(TABLES[name])
    if "base" not in table or "crazyflie21" in table["base"]:
        return
    scenario = "description" in table
    loaded = load_scenario(file) if scenario else load_config(file)
    assert loaded is not None
