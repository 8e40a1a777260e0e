"""A verdict as a table in the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from logs.verdict.types import SOURCES

_ABOUT = ("scenario", "seed", "config", "filter")
_ROWS = (
    ("outcome", "outcome", ""),
    ("violation", "violation", ""),
    ("lowest h", "h_min_m", "m"),
    ("lowest h outside the pad", "h_min_outside_pad_m", "m"),
    ("touchdown error", "touchdown_error_m", "m"),
    ("touchdown speed, vertical", "touchdown_speed_vertical_m_s", "m/s"),
    ("touchdown speed, horizontal", "touchdown_speed_horizontal_m_s", "m/s"),
    ("time to land", "time_to_land_s", "s"),
    ("real-time factor", "realtime_factor", ""),
)


def verdict_table(values: Mapping[str, Any], reason: str) -> Group:
    """Return the values of ``logs.verdict.verdict.verdict_result`` as a table; "-" for what is not known."""
    told = {name: values[name] for name in _ABOUT if values.get(name) is not None}
    title = ", ".join(f"{name} {value}" for name, value in told.items())
    table = Table()
    table.add_column("result")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, key, unit in _ROWS:
        value = values[key]
        shown = "-" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
        table.add_row(name, shown, unit)
    source = SOURCES.get(values["judged_from"], "what the onboard process said")
    return Group(Text(title, style="italic"), table, Text(f"judged from {source}"), Text(reason))
