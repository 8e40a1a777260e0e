"""Makes the HTML report of a log: one page with all its flights."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path

from flightstack.config.options import repeated
from logs.reader.flight_data import ATTACHMENT, Fleet
from logs.report import tables
from logs.report.derived import Side
from logs.report.page import Page, Panel, ReportError, need_libraries, part, write
from logs.schema import FLEET, SCENARIO
from logs.verdict.types import ESTIMATE, RADIUS_ABOVE_M, RADIUS_BESIDE_M, SOURCES, TRUTH
from logs.verdict.verdict import FleetVerdict, judged_apart, outside_envelope, unobserved

__all__ = ["ReportError", "write_report"]

_NEAR = (
    f"Measured in every physics step while both flew. The ellipsoid of two vehicles has the semi-axes "
    f"{2 * RADIUS_BESIDE_M:g} m sideways and {2 * RADIUS_ABOVE_M:g} m up and down; its measure is 1 on the "
    "surface, below is too near."
)
_EVENTS = "Times on the axis of the figures; each is a link."
_WAITS = "Times in which a member flew and gave way to neighbours, by its own messages."


def write_report(fleet: Fleet, verdict: FleetVerdict, out: Path | None = None) -> Path:
    """Write the page of a log with its verdict, by default next to the log; return its path.

    Raises like ``logs.report.page.write``.
    """
    need_libraries()
    from logs.report.figures import overview, panels
    from logs.report.style import axis_of

    name = "report" if fleet.path.name == "flight.mcap" else fleet.path.stem  # as in `sitl` and `fly`
    zero_s, run = fleet.landing_start_s or 0.0, run_of(fleet)
    sides = [
        Side(name, flight, verdict.members[name], fleet.shift_s(flight) - zero_s)
        for name, flight in fleet.flights.items()
    ]
    axis = axis_of(sides)
    picture, timeline, room = overview(fleet, sides, axis)
    figures: list[Panel | str] = []
    for side in sides:
        figures += [part("heading", side.name), *panels(side, axis)]
    events = tables.events_table(fleet.events, zero_s)
    between = (
        Panel("near", "How near they came", _NEAR, tables.pairs_table(fleet)),
        Panel("waits", "Who waited for whom", _WAITS, tables.waits_table(sides)),
    )
    about = [f"{key} {run[key]}" for key in ("seed", "filter") if key in run]
    about += [run["mode"]] if "mode" in run else []
    page = Page(
        run.get("scenario", fleet.path.stem),
        tables.headline(verdict),
        " · ".join([", ".join(fleet.flights), *about, verdict.reason]),
        tables.key_numbers(verdict, sides),
        [
            picture,
            Panel("result", "Result", _source(verdict), tables.result_table(verdict, sides)),
            part("bar", True),
            timeline,
            [panel for panel in between if panel.content],
            room,
            *figures,
            Panel("events", "Events", _EVENTS, events, style="wide events"),
            repeat_section(fleet),
            *_files(fleet, run),
        ],
        _warnings(fleet, verdict),
    )
    return write(fleet.path.with_name(f"{name}.html") if out is None else out, page)


def run_of(fleet: Fleet) -> Mapping[str, str]:
    """Return the values of the run: the metadata that are equal for all vehicles."""
    first, *others = (flight.metadata.get("run", {}) for flight in fleet.flights.values())
    shared = {key: value for key, value in first.items() if all(run.get(key) == value for run in others)}
    return {**shared, **fleet.metadata.get(FLEET, {})}


def _files(fleet: Fleet, run: Mapping[str, str]) -> tuple[Panel, Panel, str]:
    """Return the panels of the run's metadata and of the attachments as text, and the footer of the page."""
    files = [
        (f"{name}: Configuration of the onboard process", flight.attachments.get(ATTACHMENT),
         f"{name}.{ATTACHMENT}")
        for name, flight in fleet.flights.items()
    ]  # fmt: skip
    files.append(("Scenario, whole", fleet.attachments.get(SCENARIO), SCENARIO))
    found = [(what, data.decode(errors="replace"), name) for what, data, name in files if data is not None]
    return (
        Panel("run", "Run", "", tables.run_table(run, fleet)),
        Panel("configuration", "Configuration", "", part("files", found)),
        part("footer", fleet.path.name),
    )


def _source(verdict: FleetVerdict) -> str:
    sources = dict.fromkeys(each.judged_from for each in verdict.members.values())
    text = f"Judged from {' and '.join(SOURCES[each] for each in sources)}. "
    if TRUTH in sources:
        text += "True states are sampled every physics step, independent of the controller's estimate. "
    if ESTIMATE in sources:
        text += "An estimate shows neither contacts nor its own errors. "
    return text.rstrip()


def _warnings(fleet: Fleet, verdict: FleetVerdict) -> list[str]:
    texts = []
    for name, flight in fleet.flights.items():
        found = [*flight.problems]
        if outside := outside_envelope(flight):
            found.append(f"outside the proven envelope: {outside}")
        if apart := judged_apart(flight):
            found.append(apart)
        if flight.truth is None:
            found.append("no true states in this log: all values are the vehicle's own estimate")
        if flight.steps is None:
            found.append("no controller steps in this log: phases, velocities and the estimate are missing")
        if verdict.members[name].violation is None:
            found.append("data is missing, so that a barrier violation cannot be excluded")
        texts += [f"{name}: {text}" for text in found]
    pairs = [
        f"{' and '.join(names)}: the log does not show this pair to the end" for names in unobserved(fleet)
    ]
    if pairs and not any(flight.complete for flight in fleet.flights.values()):
        pairs = ["the log is incomplete"]
    return texts + [f"{text}: a collision or an ellipsoid violation cannot be excluded" for text in pairs]


def command(run: Mapping[str, str], scenario: str) -> str:
    """Return the command that repeats a flight; ``scenario``: name or file of its scenario."""
    parts = ["flightstack", "sitl", "--scenario", scenario, "--seed", run["seed"]]
    if "filter" in run:
        parts += ["--filter", run["filter"]]
    if run.get("mode") == "lockstep":
        parts.append("--lockstep")
    if "vehicle" in run:  # an autopilot's program; absent for the simulator's autopilot
        parts += [f"--{run['vehicle']}", run.get("program", "PROGRAM")]
    return shlex.join(parts + repeated(run))


def repeat_section(fleet: Fleet) -> str:
    """Return the section with the commands that repeat a run, or the reason why there are none."""
    run, whole = run_of(fleet), fleet.attachments.get(SCENARIO)
    again = ["flightstack", "replay", fleet.path.name, "--check"]
    if whole is None or "seed" not in run:
        return part("repeat", replay=shlex.join(again))
    by_name = "scenario" in run and "config" not in run
    return part(
        "repeat",
        replay=shlex.join(again),
        command=command(run, SCENARIO),
        revision=fleet.metadata.get("made", {}).get("git_revision", ""),
        lockstep=run.get("mode") == "lockstep",
        scenario=whole.decode(errors="replace"),
        by_name=command(run, run["scenario"]) if by_name else "",
    )
