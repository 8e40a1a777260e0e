"""Makes the HTML report of a log: of all its flights, or of one of them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from flightstack.config.options import repeated
from logs.reader.flight_data import ATTACHMENT, Fleet
from logs.report import tables
from logs.report.derived import Side
from logs.report.page import (
    Page,
    Panel,
    ReportError,
    need_libraries,
    part,
    write,
)
from logs.schema import FLEET, SCENARIO
from logs.verdict.types import ESTIMATE, RADIUS_ABOVE_M, RADIUS_BESIDE_M, SOURCES, TRUTH
from logs.verdict.verdict import (
    FleetVerdict,
    fleet_verdict,
    judged_apart,
    outside_envelope,
    pairs_known,
)

__all__ = ["ReportError", "write_report"]

_NEAR = (
    f"Measured in every physics step while both flew. The ellipsoid of two vehicles has the semi-axes "
    f"{2 * RADIUS_BESIDE_M:g} m sideways and {2 * RADIUS_ABOVE_M:g} m up and down; its measure is 1 on the "
    "surface, below is too near."
)
_EVENTS = "wide events"  # CSS classes of the tables of events
_WAITS = "Times in which a member flew and gave way to neighbours, by its own messages."


def write_report(fleet: Fleet, verdict: FleetVerdict, out: Path | None = None) -> dict[str, Path]:
    """Write the pages of a log with its verdict, by default next to the log; return their paths by member.

    The key "" is the main page. Raises like ``logs.report.page.write``.
    """
    need_libraries()
    name = "report" if fleet.path.name == "flight.mcap" else fleet.path.stem  # as `sitl` and `fly` name it
    target = fleet.path.with_name(f"{name}.html") if out is None else out
    if len(fleet.flights) == 1:
        return {"": write(target, page(fleet, verdict))}
    pages = {
        name: target.with_name(f"{target.stem}_{name.replace('/', '_')}{target.suffix}")
        for name in fleet.flights
    }
    for name, place in pages.items():
        flight = fleet.flights[name]
        part_of = replace(
            fleet, flights={name: flight}, events=flight.events, metadata=flight.metadata,
            attachments=flight.attachments,
        )  # fmt: skip
        write(place, page(part_of, fleet_verdict({name: verdict.members[name]}), of=target.name))
    return {"": write(target, page(fleet, verdict, pages)), **pages}


def page(
    fleet: Fleet, verdict: FleetVerdict, pages: Mapping[str, Path] | None = None, of: str | None = None
) -> Page:
    """Return the report of the flights in a log.

    ``pages``: pages of the single flights, in the same folder; ``of``: name of the page of the whole log.
    """
    from logs.report.figures import fleet_panels, panels

    first, *others = fleet.flights.values()
    several = bool(others)
    sides = [
        Side(
            name if several else "", flight, verdict.members[name],
            fleet.shift_s(flight) if several else -(flight.landing_start_s or 0.0),
        )
        for name, flight in fleet.flights.items()
    ]  # fmt: skip
    run = fleet.metadata.get("run", fleet.metadata.get(FLEET, {}))
    picture, timeline, *figures = fleet_panels(fleet, sides) if several else panels(sides[0])
    together = [
        Panel("near", "How near they came", _NEAR, tables.pairs_table(fleet)),
        Panel("waits", "Who waited for whom", _WAITS, tables.waits_table(sides)),
    ]
    title = run.get("scenario", fleet.path.stem)
    label = first.member if of is not None else ""  # name of the vehicle on the page of a fleet member
    about = [f"{key} {run[key]}" for key in ("seed", "filter") if key in run]
    about += [run["mode"]] if "mode" in run else []
    return Page(
        title if label in title else f"{title}, {label}",
        tables.headline(verdict),
        " · ".join([*[f"{len(sides)} vehicles"] * several, *about, verdict.reason]),
        tables.key_numbers(verdict, sides),
        [
            part("paragraph", part("link", of, "The whole fleet")) if of is not None else "",
            picture,
            Panel("result", "Result", _source(verdict), tables.result_table(verdict, sides, pages or {})),
            part("bar", True),
            timeline,
            *figures,
            *([together] if several else []),
            Panel(
                "events", "Events",
                f"Times since the {'log' if several else 'landing'} began; each is a link.",
                tables.events_table(fleet.events, 0.0 if several else -sides[0].offset_s), style=_EVENTS,
            ),
            repeat_section(fleet, label),
            Panel("run", "Run", "", tables.run_table(fleet.metadata)),
            *_configuration(fleet),
        ],
        _warnings(fleet, verdict),
    )  # fmt: skip


def _configuration(fleet: Fleet) -> tuple[Panel, str]:
    """Return a panel that shows the attachments as text, and the footer of the page."""
    files = [
        (f"{flight.member}: Configuration of the onboard process", flight.attachments.get(ATTACHMENT),
         f"{flight.member}.{ATTACHMENT}")
        for flight in fleet.flights.values()
    ]  # fmt: skip
    files.append(("Scenario, whole", fleet.attachments.get(SCENARIO), SCENARIO))
    found = [(what, data.decode(errors="replace"), name) for what, data, name in files if data is not None]
    return Panel("configuration", "Configuration", "", part("files", found)), part("footer", fleet.path.name)


def _source(verdict: FleetVerdict) -> str:
    sources = dict.fromkeys(each.judged_from for each in verdict.members.values())
    text = f"Judged from {' and '.join(SOURCES[each] for each in sources)}. "
    if TRUTH in sources:
        text += "True states are sampled every physics step, independent of the controller's estimate. "
    if ESTIMATE in sources:
        text += "An estimate shows neither contacts nor its own errors. "
    if len(verdict.members) > 1:
        text += "The fleet has landed when all its members have."
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
    if len(fleet.flights) > 1 and not pairs_known(fleet):
        texts.append(
            "the simulator did not follow all pairs to the end: a collision or an ellipsoid violation cannot "
            "be excluded"
        )
    return texts


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


def repeat_section(fleet: Fleet, member: str = "") -> str:
    """Return the section with the commands that repeat a flight, or the reason why there are none.

    ``member``: name of the vehicle if it flew in a fleet; only the whole fleet can fly again.
    """
    run, whole = fleet.metadata.get("run", fleet.metadata.get(FLEET, {})), fleet.attachments.get(SCENARIO)
    again = ["flightstack", "replay", fleet.path.name, "--check"]
    if member:
        return part("repeat", replay=shlex.join([*again, "--member", member]), alone=False)
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
