"""Tests the limits of files and folders, and that pyproject.toml declares what each package imports."""

import re
import subprocess
import sys
import tomllib
from collections import Counter
from importlib.metadata import packages_distributions
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[3]
LINES_MAX, FILES_MAX = 400, 16


def test_files_and_folders_are_small():
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    files = [ROOT / name for name in listed.stdout.splitlines() if (ROOT / name).exists()]
    assert {file: n for file in files if (n := len(file.read_text().splitlines())) > LINES_MAX} == {}
    assert {place: n for place, n in Counter(f.parent for f in files).items() if n > FILES_MAX} == {}


OURS = ("flightstack", "bridge", "sim", "logs")
# packages that need more than the onboard process does, and the extras that each of them may use
EXTRAS = {
    "bridge.crazyflie": {"crazyflie"},
    "flightstack.api": {"sim", "export", "report", "env"},
    "flightstack.cli": {"view"},
    "flightstack.compiled": {"sim"},  # an optional extra: see tests/unit/compiled/test_core.py
    "logs.report": {"report"},
    "logs.tools": {"export"},
    "logs.view": {"view"},
    "sim": {"sim"},
    "sim.flights": {"sim", "export"},
    "sim.validation": {"sim", "export"},
    "sim.campaign": {"sim", "cluster", "report", "export"},
}
# distributions whose extension module is loaded by name, without an import statement
BY_NAME = {"osqp": "flightstack/core/safety/osqp.py"}


def names(requirements):
    return {re.match(r"[\w.-]+", each)[0].lower() for each in requirements}


def test_every_import_is_declared_in_its_layer_and_everything_declared_is_imported():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = {name: names(wanted) for name, wanted in project["optional-dependencies"].items()}
    distributions = packages_distributions()
    graph = grimp.build_graph(*OURS, include_external_packages=True, cache_dir=None)
    undeclared, used = set(), set()
    for module in sorted(m for m in graph.modules if m.partition(".")[0] in OURS):
        place = max((p for p in EXTRAS if f"{module}.".startswith(f"{p}.")), key=len, default="")
        allowed = names(project["dependencies"]).union(*(extras[name] for name in EXTRAS.get(place, ())))
        for library in graph.find_modules_directly_imported_by(module):
            if library.partition(".")[0] in (*OURS, *sys.stdlib_module_names):
                continue
            found = {name.lower() for name in distributions.get(library, ["not installed"])}
            used |= found
            if not found & allowed:
                undeclared.add((module, library, *found))
    assert undeclared == set()
    declared = names(project["dependencies"]).union(*(extras[e] for each in EXTRAS.values() for e in each))
    used |= {name for name, file in BY_NAME.items() if f'"{name}.' in (ROOT / file).read_text()}
    assert declared - used == set()
