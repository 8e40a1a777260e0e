"""Branch coverage of the safety core by its own tests; every branch is to be taken."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import coverage
import pytest

from tests.mutation.mutants import ROOT, TARGETS, source_file


class Covered(NamedTuple):
    """One module's coverage."""

    per_cent: float
    missing_lines: list[int]
    missing_branches: list[list[int]]  # from line, to line; negative: out of the function


def measure() -> tuple[int, dict[str, Covered]]:
    """Run the tests once, in this process, which must not have imported the core before.

    Returns:
        pytest's exit code, and the coverage of each module.
    """
    files = sorted({file for tests in TARGETS.values() for file in tests})
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "coverage.json"
        watch = coverage.Coverage(
            data_file=str(Path(folder) / "coverage"),
            branch=True,
            include=[str(source_file(module)) for module in TARGETS],
            config_file=False,
        )
        watch.start()
        options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-o", "addopts=--import-mode=importlib"]
        exit_code = pytest.main([*options, f"--rootdir={ROOT}", *(str(ROOT / file) for file in files)])
        watch.stop()
        watch.json_report(outfile=str(report))
        measured = {Path(name).name: m for name, m in json.loads(report.read_text())["files"].items()}
    found = {}
    for module in TARGETS:
        m = measured[source_file(module).name]
        found[module] = Covered(m["summary"]["percent_covered"], m["missing_lines"], m["missing_branches"])
    return int(exit_code), found
