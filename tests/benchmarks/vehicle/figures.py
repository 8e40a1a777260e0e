"""Generates the tables and figures of docs/how_it_works/vehicle.md: the vehicle and published numbers.

python -m tests.benchmarks vehicle_figures
"""

from __future__ import annotations

import re
from pathlib import Path

from tests.benchmarks.vehicle.tables import tables

DOCS = Path(__file__).parents[3] / "docs"
PAGE = DOCS / "how_it_works" / "vehicle.md"
BLOCK = re.compile(r"(<!-- table (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def written_tables() -> dict[str, str]:
    """Return the current tables of the page, by name."""
    return {match[2]: match[3].rstrip("\n") for match in BLOCK.finditer(PAGE.read_text())}


def main() -> None:
    from tests.benchmarks.vehicle.plots import draw  # late import: tables need no plotting library

    fresh = tables()
    text = BLOCK.sub(lambda match: f"{match[1]}{fresh[match[2]]}\n{match[4]}", PAGE.read_text())
    PAGE.write_text(text)
    print(f"{PAGE}: {len(fresh)} tables")
    for file in draw(DOCS / "figures"):
        print(f"{file}: {file.stat().st_size / 1024:.0f} KB")


if __name__ == "__main__":
    main()
