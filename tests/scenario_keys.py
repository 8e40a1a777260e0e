"""Writes the tables of docs/reference/scenario_keys.md: ``python -m tests.scenario_keys``."""

from pathlib import Path

from sim.scenarios.keys import keys

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "scenario_keys.md"
TOP = "\n## At the top\n"  # heading of the first table; the text before it is written by hand
HEAD = "| key | unit | default | allowed | meaning |\n|---|---|---|---|---|"


def page():
    """Return the page: its text, then a section for each table of a scenario."""
    text, table = PAGE.read_text().partition(TOP)[0], None
    for key in sorted(keys(), key=lambda each: each.table.startswith("onboard")):
        if key.table != table:
            table = key.table
            text += f"\n## `[{table}]`\n\n{HEAD}\n" if table else f"{TOP}\n{HEAD}\n"
        default = f"`{key.default}`" if key.default else "required"
        cells = (f"`{key.name}`", key.unit, default, key.allowed, key.meaning)
        text += f"| {' | '.join(each.replace('|', chr(92) + '|') for each in cells)} |\n"
    return text


if __name__ == "__main__":
    PAGE.write_text(page())
