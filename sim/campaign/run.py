"""Many seeded landings of one scenario: rows, a summary with confidence bounds, a page.

A campaign is a folder. Each row is appended on arrival, so a campaign can be interrupted, killed or extended
at any time: the same call continues it. A file next to the rows identifies scenario, seeds and code; a folder
with a different identity is rejected.
"""

from __future__ import annotations

import fcntl
import hashlib
import inspect
import json
import platform
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flightstack.core.parameters.filters import FILTERS, named
from flightstack.verify.certificate import refuse
from logs.report.page import Page, Panel, need_libraries, part, write
from logs.verdict.types import VIOLATION_LIMIT_M
from sim.campaign.rows import (
    CELL_M,
    D_CELLS,
    E_Z_CELLS,
    E_Z_LOW_M,
    Row,
    RowsError,
    appending,
    cell_map,
    read_rows,
    write_rows,
)
from sim.campaign.summary import apart, lines, summary
from sim.campaign.workers import code_fingerprint, fly_here, fly_on_cluster
from sim.robot import try_out
from sim.runners.landing import warm_up
from sim.scenarios.scenario import Scenario, load, text
from sim.vehicle.declared import judged_apart

if TYPE_CHECKING:
    import plotly.graph_objects as go

ROWS, ABOUT, SUMMARY = "rows.csv", "campaign.json", "summary.json"
LOCK, PAGE = "campaign.lock", "campaign.html"
_PACKAGES = ("numpy", "osqp", "mujoco", "numba", "pymavlink")

OnRow = Callable[[Row], None]


@dataclass(frozen=True)
class Plan:
    """Definition of a campaign: scenario and seeds."""

    scenario_name: str  # name or file of the scenario, as the user gave it; printed commands contain it
    scenario: Scenario  # scenario, with the safety filter to fly
    runs: int  # number of landings to fly
    first_seed: int  # first of consecutive seeds

    @property
    def scenario_toml(self) -> str:
        """Text of a complete scenario file, for the workers."""
        return text(self.scenario)

    @property
    def command(self) -> str:
        """Command that repeats one seed, with ``{seed}`` as placeholder."""
        name = shlex.quote(self.scenario_name).replace("{", "{{").replace("}", "}}")
        return f"flightstack sitl --scenario {name} --seed {{seed}} --filter {self.filter_name} --lockstep"

    @property
    def filter_name(self) -> str:
        """Name of the safety filter; in a team, that of the first vehicle."""
        return self.scenario.onboard.filter

    @property
    def duration_max_s(self) -> float:
        """Maximum simulated time of a landing, s; for a team the sum over all vehicles."""
        return sum(each.duration_max_s for each in self.scenario.members)


def plan(scenario_name: str, runs: int, first_seed: int, filter_name: str | None) -> Plan:
    """Load and check a scenario. Raises ConfigError: a check rejects the scenario."""
    scenario = load(scenario_name)
    for member in scenario.members:
        try_out(member.target)
    if filter_name is not None:
        scenario = scenario.with_filter(filter_name)
    refuse((each.onboard for each in scenario.members), scenario_name)
    return Plan(scenario_name, scenario, runs, first_seed)


@dataclass(frozen=True)
class Flown:
    """Result of ``fly``: the rows and their summary."""

    rows: list[Row]  # all rows of the folder, ordered by seed
    missing: int  # number of landings without a row
    summary: dict[str, Any] | None  # summary of the rows; None: no rows


def _known_rows(wanted: Plan, now: dict[str, Any], folder: Path) -> list[Row]:
    """Return the rows of a folder; ``now``: data that all rows must share (``identity``).

    Raises RowsError: the folder has rows of another campaign, rows of other seeds, or damaged rows.
    """
    path, about = folder / ROWS, folder / ABOUT
    if not path.exists() and not about.exists():
        return []
    try:
        before = dict(json.loads(about.read_text()))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise RowsError(f"{about}: cannot be read ({error}); give another --out") from None
    for key in sorted({*now, *before}):
        text = now.get(key)
        if before.get(key) != text:
            shown = "" if "\n" in str(text) else f" (was {before.get(key)}, is {text})"
            raise RowsError(f"{folder}: holds a campaign with another {key}{shown}; give another --out")
    rows = read_rows(path) if path.exists() else []
    last = wanted.first_seed + wanted.runs - 1
    beyond = sum(not wanted.first_seed <= row.seed <= last for row in rows)
    if beyond:
        raise RowsError(
            f"{folder}: holds {len(rows)} rows, {beyond} of them beyond seed {last}; ask for at least "
            f"{max(row.seed for row in rows) - wanted.first_seed + 1} runs, or give another --out"
        )
    return rows


def fly(wanted: Plan, folder: Path, *, workers: int, cluster: str | None, on_row: OnRow) -> Flown:
    """Fly the missing landings and write the summary; after an interrupt the rows so far are kept.

    ``workers``: number of processes, unused on a cluster; ``cluster``: address of a Dask scheduler, None:
    this machine; ``on_row``: called with each row, including rows of earlier calls. Raises RowsError: the
    folder has other content, or another campaign runs there; WorkersError: no worker process starts;
    ClusterError: the cluster cannot be used.
    """
    began_s = time.monotonic()
    folder.mkdir(parents=True, exist_ok=True)
    with alone(folder):
        about = identity(wanted)
        rows = _known_rows(wanted, about, folder)
        (folder / ABOUT).write_text(json.dumps(about, indent=1) + "\n")
        for row in rows:
            on_row(row)
        flown_s = 0.0
        have = {row.seed for row in rows}
        todo = [
            seed for seed in range(wanted.first_seed, wanted.first_seed + wanted.runs) if seed not in have
        ]
        try:
            if todo:
                with appending(folder / ROWS) as add:
                    if cluster is None:
                        warm_up(wanted.scenario)  # compile once for all workers
                    began_s = time.monotonic()  # the reported speed does not include compilation
                    for row in _rows(wanted, todo, workers, cluster):
                        add(row)
                        flown_s += row.simulated_s or 0.0
                        on_row(row)
        except KeyboardInterrupt:
            pass  # the result reports the number of missing rows
        if todo:  # after an interrupt, the file may have a row that the list lacks
            rows = sorted(read_rows(folder / ROWS), key=lambda row: row.seed)
        write_rows(folder / ROWS, rows)
        told = None
        if rows:
            told = summary(
                rows, wanted.command, wall_s=time.monotonic() - began_s, flown_s=flown_s,
                judged_apart=judged_apart(wanted.scenario),
            )  # fmt: skip
            (folder / SUMMARY).write_text(json.dumps(told, indent=1) + "\n")
        return Flown(rows, wanted.runs - len(rows), told)


def _rows(wanted: Plan, todo: list[int], workers: int, cluster: str | None) -> Iterator[Row]:
    if cluster is not None:
        return fly_on_cluster(cluster, wanted.scenario_toml, todo)
    return fly_here(wanted.scenario_toml, todo, workers, wanted.duration_max_s)


def identity(wanted: Plan) -> dict[str, Any]:
    """Return the data that all rows of a folder share."""
    return {
        "scenario": wanted.scenario_toml,
        **_filter(wanted.filter_name),
        "first seed": wanted.first_seed,
        "code": code_fingerprint(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: metadata.version(name) for name in _PACKAGES},
    }


def _filter(name: str) -> dict[str, str]:
    """Return the name of the filter, and a hash of its source if it is not part of the package."""
    if name in FILTERS:
        return {"filter": name}
    source = Path(inspect.getfile(named(name))).read_bytes()
    return {"filter": name, "filter's code": hashlib.sha256(source).hexdigest()[:16]}


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Lock a folder against other campaigns; add the folder's name to system errors, such as a full disk.

    Raises RowsError: another campaign holds the lock.
    """
    with (folder / LOCK).open("w") as lock:
        try:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # worker processes do not inherit this lock
        except BlockingIOError:
            raise RowsError(
                f"{folder}: another campaign runs there; wait for it, or give another --out"
            ) from None
        try:
            yield
        except OSError as error:
            if error.filename is None and error.errno is not None:
                error.filename = str(folder)
            raise


_BINS = 60
_JUDGED = (
    "Judged from true states at every physics step. The upper bound of the violation rate is the one-sided "
    "bound of Clopper and Pearson; what is not known counts as a violation."
)
_ALONE = "Each command flies one of them alone, to the same end."
_MAP = (
    "Each cell shows the lowest true h of all landings there; the line is the boundary h = 0. "
    "Cells below it were entered on the last centimetres over the pad, or by a violation."
)

# each: name of the panel, title, text of the x axis, factor from the column to the axis, column of the rows
_HISTOGRAMS = (
    ("error", "Touchdown error", "d at first contact [cm]", 100.0, "touchdown_error_m"),
    ("vertical", "Touchdown speed, vertical", "relative to the pad, downwards [m/s]", 1.0,
     "touchdown_speed_vertical_m_s"),
    ("horizontal", "Touchdown speed, horizontal", "relative to the pad [m/s]", 1.0,
     "touchdown_speed_horizontal_m_s"),
    ("time", "Time to land", "begin of the landing to first contact [s]", 1.0, "time_to_land_s"),
    ("h", "Lowest h outside the pad", "h [mm]", 1000.0, "h_min_outside_pad_m"),
)  # fmt: skip


def write_page(path: Path, wanted: Plan, flown: Flown) -> None:
    """Write the page; ``flown`` has a summary. Raises ReportError: the plotting library is not installed."""
    need_libraries()
    summary = flown.summary or {}
    bad = summary["crashes"] or summary["violations"] or summary["undeclared_misses"] or flown.missing
    style = "bad" if bad else "good" if summary["landed"] == summary["runs"] else "fair"
    seeds = f"seeds {wanted.first_seed} to {wanted.first_seed + wanted.runs - 1}"
    lacking = f" · {flown.missing} landings are missing" if flown.missing else ""
    shown = lines(summary)
    worst = [(str(w["seed"]), w["why"], w["command"]) for w in summary["worst"]]
    first = ("barrier violated, or not known", "lowest h outside the pad", "touchdown error, 95 %",
             "time to land, median")  # fmt: skip
    page = Page(
        f"{wanted.scenario.name}, filter {wanted.filter_name}",
        (f"{summary['landed']} of {summary['runs']} landed", style),
        f"{wanted.scenario.description} · {seeds}{lacking}",
        [line for line in shown if line[0] in first],
        [
            Panel("map", "Lowest h over d and e_z", _MAP, h_map(wanted, flown.rows)),
            Panel("result", "Result", _JUDGED, part("table", ("result", "value", "unit"), shown, (1,))),
            Panel("worst", "Worst seeds", _ALONE, part("table", ("seed", "why", "command"), worst, (0,))),
            *(_histogram(flown.rows, *each) for each in _HISTOGRAMS),
            Panel("scenario", "", "", part("details", "Scenario", wanted.scenario_toml, "scenario.toml")),
        ],
        apart(summary),
    )  # fmt: skip
    write(path, page)


def _histogram(rows: Sequence[Row], key: str, title: str, axis: str, scale: float, column: str) -> Panel:
    """Return the panel of one row of ``_HISTOGRAMS``; in that of h, a line marks the limit of a violation."""
    import plotly.graph_objects as go

    from logs.curves import BOUNDARY, TRUE
    from logs.report.style import layout

    figure, values = None, [scale * v for row in rows if (v := getattr(row, column)) is not None]
    if values:
        counts, edges = np.histogram(values, bins=_BINS)
        middles, marker = 0.5 * (edges[:-1] + edges[1:]), {"color": TRUE}
        figure = layout(go.Figure(go.Bar(x=middles, y=counts, width=np.diff(edges), marker=marker)), 300)
        figure.update_layout(bargap=0.0, showlegend=False)
        figure.update_xaxes(title_text=axis)
        figure.update_yaxes(title_text="landings")
        if column == "h_min_outside_pad_m":
            figure.add_vline(x=scale * VIOLATION_LIMIT_M, line={"color": BOUNDARY, "dash": "dash"})
    return Panel(key, title, f"{len(values)} of {len(rows)} landings have this value.", figure)


def h_map(wanted: Plan, rows: Sequence[Row]) -> go.Figure:
    """Return the map of the lowest h over distance and height, with the boundary h = 0."""
    import plotly.graph_objects as go

    from logs.curves import BOUNDARY
    from logs.report.style import layout

    lowest_m, visits = cell_map(rows)
    d_m = (np.arange(D_CELLS) + 0.5) * CELL_M
    e_z_m = E_Z_LOW_M + (np.arange(E_Z_CELLS) + 0.5) * CELL_M
    figure = layout(
        go.Figure(
            go.Heatmap(
                x=d_m, y=e_z_m, z=1e3 * lowest_m, customdata=visits, zmin=-300, zmax=300, colorscale="RdBu",
                colorbar={"title": "h [mm]"},
                hovertemplate="d %{x:.2f} m, e_z %{y:.2f} m<br>lowest h %{z:.0f} mm<br>%{customdata} landings"
                "<extra></extra>",
            )
        ),
        460,
    )  # fmt: skip
    at = np.linspace(0.0, D_CELLS * CELL_M, 200)
    height = list(map(wanted.scenario.judged_by.height, at))
    figure.add_scatter(
        x=at, y=height, mode="lines", line={"color": BOUNDARY, "width": 2}, name="boundary h = 0"
    )
    figure.update_xaxes(title_text="d [m]", range=[0.0, D_CELLS * CELL_M])
    figure.update_yaxes(title_text="e_z [m]", range=[E_Z_LOW_M, E_Z_LOW_M + E_Z_CELLS * CELL_M])
    return figure
