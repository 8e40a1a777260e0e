"""Teams of ``fleet_3``: this software beside one central program for all vehicles (``central.py``).

``python -m tests.benchmarks fleet_baseline [--runs N] [--workers N] [--only KIND ...] [--out DIR]``

Prints one line of a table for each kind. Rows are kept in the folder: the same call goes on where it was.
"""

import argparse
import gc
import hashlib
import multiprocessing
import os
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

from sim.campaign.rows import Row, RowsFile, error_row, missing, read_rows
from sim.campaign.summary import quantile, summary
from sim.campaign.team_rows import team_row
from sim.campaign.workers import code_fingerprint
from sim.runners.fleet.team import TeamLanding, land_team, warm_up
from sim.scenarios import team
from sim.scenarios.team import TeamScenario
from tests.benchmarks import central

ROOT = Path(__file__).parents[2]
TEAM = "fleet_3"
# s_i + s_j of the central program, m: the ellipsoid's horizontal semi-axis, and a sphere that holds all of it
KINDS = {
    "robust": ("ours, robust filter", None),
    "paper": ("ours, the paper's landing filter", None),
    "central_0.25": ("central program, 0.25 m apart", 0.25),
    "central_0.75": ("central program, 0.75 m apart", 0.75),
}
COLUMNS = (
    "fleet_3", "teams", "vehicles landed", "crashed", "collisions", "ellipsoid violations",
    "least in semi-axes", "nearest", "teams with a barrier violation",
    "error, median / 95 % of the worst of a team", "time to the last touch, median",
)  # fmt: skip


@cache
def scenario(kind: str) -> TeamScenario:
    """The team of a kind, with all code compiled."""
    found, (_, distance_m) = team.load(TEAM), KINDS[kind]
    found = found.with_filter(kind) if distance_m is None else central.central_team(found)
    warm_up(found)
    return found


def fly(asked: tuple[str, int]) -> Row:
    """Fly one team; what cannot be flown is a row, too."""
    kind, seed = asked
    try:
        landing, said = flown(kind, seed)
        found = team_row(landing)
        return replace(found, reason=found.reason + said)
    except Exception as error:
        return error_row(seed, f"{type(error).__name__}: {error}")
    finally:
        gc.collect()


def flown(kind: str, seed: int) -> tuple[TeamLanding, str]:
    """Fly one team; the landing, and what its program has to say."""
    found, (_, distance_m) = scenario(kind), KINDS[kind]
    if distance_m is None:
        return land_team(found, seed), ""
    program = central.Central(found, distance_m)
    landing = land_team(found, seed, exchange=program)
    relaxed = sum(each.relaxed for each in program.programs.values())
    unsolved = sum(each.unsolved for each in program.programs.values())
    return landing, f" (rows gave way in {relaxed} ticks, unsolved in {unsolved})"


def campaign(kind: str, runs: int, workers: int, folder: Path) -> None:
    """Fly, or go on with, one kind."""
    code = code_fingerprint() + hashlib.sha256(Path(central.__file__).read_bytes()).hexdigest()[:8]
    path, about = folder / f"{kind}.csv", folder / f"{kind}.code"
    if path.exists() and about.read_text() != code:
        sys.exit(f"{path}: flown with other code; give another --out")
    about.write_text(code)
    scenario(kind)  # compiled once, for all workers
    todo = [(kind, seed) for seed in missing(read_rows(path) if path.exists() else [], 0, runs)]
    context = multiprocessing.get_context("spawn")
    with RowsFile(path) as file, context.Pool(workers) as pool:
        for each in pool.imap_unordered(fly, todo):
            file.add([each])


def line(kind: str, rows: list[Row]) -> str:
    """Line of the table."""
    told = summary(rows, "", wall_s=0.0, flown_s=0.0)
    crashed = sum(each.outcomes.split().count("crashed") for each in rows)
    time_s = quantile(rows, lambda each: each.time_to_land_s, 0.5)
    errors = [f"{100 * each:.1f}" for each in told["touchdown_error_m"].values() if each is not None]
    cells = (
        KINDS[kind][0],
        told["runs"],
        f"{told['vehicles_landed']} of {told['vehicles']}",
        crashed,
        told["collisions"],
        told["ellipsoid_violations"],
        f"{told['ellipsoid_min']:.2f}",
        f"{told['distance_min_m']:.2f} m",
        told["violations"],
        f"{' / '.join(errors)} cm" if errors else "-",
        f"{time_s:.1f} s" if time_s is not None else "-",
    )
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="teams of each kind")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument(
        "--only", nargs="*", choices=KINDS, default=list(KINDS), help="fly these only; none: print"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "fleet_baseline")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}", flush=True)
    for kind in KINDS:
        if kind in asked.only:
            campaign(kind, asked.runs, asked.workers, asked.out)
        path = asked.out / f"{kind}.csv"
        if path.exists() and (rows := read_rows(path)):
            print(line(kind, rows), flush=True)
