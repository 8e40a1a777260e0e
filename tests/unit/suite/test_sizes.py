"""Tests the limits on the length of a file and on the number of files in a folder."""

import subprocess
from collections import Counter
from pathlib import Path

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
