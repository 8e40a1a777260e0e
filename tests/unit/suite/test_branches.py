"""Every line and branch of the safety core is taken by its fast tests (docs/how_it_works/safety_core.md)."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
EXAMPLES = """
import hypothesis
hypothesis.settings.register_profile("few", derandomize=True, database=None, deadline=None, max_examples=60)
"""


@pytest.mark.slow
def test_every_branch_of_the_safety_core_is_taken(tmp_path):
    core = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mutmut"]
    (tmp_path / "few_examples.py").write_text(EXAMPLES)
    data = ["--data-file", str(tmp_path / "coverage")]
    subprocess.run(
        [
            sys.executable, "-m", "coverage", "run", *data,
            "--branch", f"--include={','.join(core['only_mutate'])}",
            "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "few_examples",
            "--hypothesis-profile=few", *core["pytest_add_cli_args_test_selection"],
        ],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(tmp_path)}, check=True, timeout=280.0,
    )  # fmt: skip
    report = tmp_path / "report.json"
    subprocess.run([sys.executable, "-m", "coverage", "json", *data, "-o", str(report)], cwd=ROOT, check=True)
    files = json.loads(report.read_text())["files"]
    assert set(files) == set(core["only_mutate"])
    missing = {name: (f["missing_lines"], f["missing_branches"]) for name, f in files.items()}
    assert {name: found for name, found in missing.items() if found != ([], [])} == {}
