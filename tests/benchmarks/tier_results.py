"""Flies many seeds of the tiers with both filters and of the teams; fills docs/reference/results.md.

``python -m tests.benchmarks tier_results [NAME ...] [--seed N] [--runs N] [--out DIR] [--write-only]``

NAME: a tier, with or without its filter (``field``, ``field_paper``), or a team. Table rows of other
campaigns do not change.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

from sim.campaign.rows import Row, read_rows
from sim.campaign.summary import summary
from tests.benchmarks.tiers import LIMITS, Tier, misses

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "results.md"
TIERS = ("lab", "room", "field", "storm", "deck")
FILTERS = ("robust", "paper")
TEAMS = {"fleet_3": 10_000, "fleet_8": 2_000, "turns_4": 200}
RUNS = {f"{tier}_{kind}": 10_000 for tier in TIERS for kind in FILTERS} | {
    f"{name}_robust": runs for name, runs in TEAMS.items()
}


def campaign(name: str, kind: str, seed: int, runs: int, folder: Path) -> None:
    """Fly one campaign, or continue an interrupted one."""
    command = [
        sys.executable, "-m", "flightstack.cli.main", "campaign", name, "--filter", kind, "--seed", str(seed),
        "--runs", str(runs), "--out", str(folder), "--json", "--no-report",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: exit status {done.returncode}")


def row(tier: str, kind: str, s: dict) -> str:
    """Return the table row of one tier, with the results of its campaign."""
    error, time_s = s["touchdown_error_m"], s["time_to_land_s"]["median"]
    vertical, horizontal = (
        s["touchdown_speed_vertical_m_s"]["p95"],
        s["touchdown_speed_horizontal_m_s"]["p95"],
    )
    return (
        f"| `{tier}`, {kind} | {s['runs']} | {s['landed']} | {s['declared_aborts']} "
        f"| {s['undeclared_misses']}, {s['crashes']} "
        f"| {s['violations']} ({100 * s['upper_95_violation_rate']:.3g} %) "
        f"| {1000 * s['h_min_outside_pad_m']:+.0f} mm "
        f"| {100 * error['median']:.1f} / {100 * error['p95']:.1f} cm "
        f"| {vertical:.2f} / {horizontal:.2f} m/s "
        f"| {time_s:.1f} s |"
    )


def known(folder: Path) -> list[Row]:
    path = folder / "rows.csv"
    return read_rows(path) if path.exists() else []


def asked_row(tier: str, out: Path) -> str:
    """Return the table row with a tier's limits and the limits that the campaign does not meet."""
    limits = LIMITS[Tier(tier)]
    robust, paper = (known(out / f"{tier}_{kind}") for kind in FILTERS)
    found = misses(Tier(tier), robust, paper or None)
    allowed = f"<= {100 * limits.violations_max:g} %" if limits.violations_max else "none"
    slower = f"{100 * (limits.slower_max - 1):+.0f} %" if limits.slower_max is not None else "-"
    return (
        f"| `{tier}` | >= {100 * limits.landed_min:g} % | {allowed} "
        f"| {100 * limits.error_m[0]:.1f} / {100 * limits.error_m[1]:.1f} cm "
        f"| {limits.vertical_m_s:.2f} / {limits.horizontal_m_s:.2f} m/s | {slower} "
        f"| {'; '.join(found) or 'all met'} |"
    )


def team_row(name: str, s: dict) -> str:
    """Return the table row of one team, with the results of its campaign."""
    error = s["touchdown_error_m"]
    return (
        f"| `{name}`, robust | {s['runs']} | {s['vehicles_landed']} of {s['vehicles']} | {s['collisions']} "
        f"| {s['ellipsoid_violations']} | {s['ellipsoid_min']:.2f} | {s['distance_min_m']:.2f} m "
        f"| {s['violations']} | {1000 * s['h_min_outside_pad_m']:+.0f} mm "
        f"| {100 * error['median']:.1f} / {100 * error['p95']:.1f} cm |"
    )


def filled(page: str, name: str, lines: list[str]) -> str:
    """Return the page with these rows in one of its tables; a row replaces the row with the same first cell.

    Raises ValueError: the page has no such table, or the table has no such row.
    """
    found = re.search(rf"<!-- table: {name} -->\n(.*?)<!-- end -->", page, re.DOTALL)
    if found is None:
        raise ValueError(f"{PAGE}: no table {name!r}")
    table = found[1]
    for line in lines:
        first = "|".join(line.split("|")[:2]) + "|"
        old = [each for each in table.splitlines() if each.startswith(first)]
        if len(old) != 1:
            raise ValueError(f"{PAGE}, table {name!r}: {len(old)} lines begin with {first!r}, one is needed")
        table = table.replace(old[0], line)
    return page[: found.start(1)] + table + page[found.end(1) :]


def chosen(names: list[str]) -> list[str]:
    """Return the campaigns with these names, or all without names. Raises ValueError: a name is unknown."""
    found = [each for each in RUNS if not names or {each, each.rpartition("_")[0]} & set(names)]
    unknown = set(names) - {word for each in RUNS for word in (each, each.rpartition("_")[0])}
    if unknown:
        raise ValueError(f"found {sorted(unknown)}, allowed are {', '.join(RUNS)}; without the filter: both")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="tiers, with or without their filter, and teams; none: all")
    parser.add_argument("--seed", type=int, default=30_001, help="the first")
    parser.add_argument("--runs", type=int, help="of each; default: as many as the page has")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "tiers")
    parser.add_argument(
        "--write-only", action="store_true", help="fill the tables with what was flown before"
    )
    asked, lines = parser.parse_args(), {"tiers": [], "asked": [], "teams": []}
    try:
        campaigns = chosen(asked.names)
    except ValueError as error:
        parser.error(str(error))
    for each in campaigns:
        name, _, kind = each.rpartition("_")
        if not asked.write_only:
            campaign(name, kind, asked.seed, asked.runs or RUNS[each], asked.out / each)
        if rows := known(asked.out / each):
            told = summary(rows, "", wall_s=0.0, flown_s=0.0)
            if name in TEAMS:
                lines["teams"].append(team_row(name, told))
            else:
                lines["tiers"].append(row(name, kind, told))
    lines["asked"] = [asked_row(tier, asked.out) for tier in TIERS if known(asked.out / f"{tier}_robust")]
    page = PAGE.read_text()
    for name, each in lines.items():
        print("\n".join(each))
        page = filled(page, name, each)
    PAGE.write_text(page)
