"""Makes the HTML report of a log: of one flight, or of a fleet."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from flightstack.config.options import repeated
from logs.reader.flight_data import ATTACHMENT, Fleet, Flight
from logs.report import tables
from logs.report.derived import Side
from logs.report.page import (
    Page,
    Panel,
    ReportError,
    details,
    html,
    need_libraries,
    paragraph,
    part,
    write,
)
from logs.schema import FLEET, SCENARIO
from logs.verdict.types import SOURCES, TRUTH, Outcome, Verdict
from logs.verdict.verdict import (
    FleetVerdict,
    judged_apart,
    outside_envelope,
    pair_series,
    pairs_known,
)

__all__ = ["ReportError", "write_report"]

_FILES = ((ATTACHMENT, "Configuration of the onboard process"), (SCENARIO, "Scenario, whole"))
_NEAR = "Measured in every physics step while both flew."
_EVENTS = "wide events"  # CSS classes of the tables of events
_WAITS = "Times in which a member flew and gave way to neighbours, by its own messages."


def write_report(fleet: Fleet, verdict: FleetVerdict, out: Path | None = None) -> dict[str, Path]:
    """Write the pages of a log with its verdict, by default beside it; return their paths by member.

    The key "" is the main page. Raises ReportError: the plotting library is not installed.
    """
    need_libraries()
    target, (first, *others) = _beside(fleet.path) if out is None else out, fleet.flights
    if not others:
        return {"": write(target, flight_page(fleet.flights[first], verdict.members[first]))}
    members = {
        name: target.with_name(f"{target.stem}_{name.replace('/', '_')}{target.suffix}")
        for name in fleet.flights
    }
    for name, place in members.items():
        write(place, flight_page(fleet.flights[name], verdict.members[name], target.name))
    return {"": write(target, fleet_page(fleet, verdict, members)), **members}


def _beside(log: Path) -> Path:
    """Return the default path of a log's page: that of ``sitl`` and ``fly``, or the log's own name."""
    return log.with_name(f"{'report' if log.name == 'flight.mcap' else log.stem}.html")


def flight_page(flight: Flight, verdict: Verdict, of: str | None = None) -> Page:
    """Return the report of a flight; ``of``: page of its fleet, to which the report links."""
    from logs.report.figures import panels

    side = Side("", flight, verdict, -(flight.landing_start_s or 0.0))
    run = flight.metadata.get("run", {})
    picture, timeline, *figures = panels(side)
    title = run.get("scenario", flight.path.stem)
    if flight.label not in title:
        title = f"{title}, {flight.label}"
    sources = [(what, flight.attachments.get(name), name) for name, what in _FILES]
    return Page(
        title, tables.headline(verdict), " · ".join([*_flown(run), verdict.reason]), tables.key_numbers(side),
        [
            html('<p><a href="{}">The whole fleet</a></p>').format(of) if of is not None else "",
            picture,
            Panel("result", "Result", _source(verdict), tables.result_table(side)),
            part("bar", True),
            timeline,
            *figures,
            Panel(
                "events", "Events", "Times since the landing began; each is a link.",
                tables.events_table(flight.events, -side.offset_s), style=_EVENTS,
            ),
            repeat_section(flight, flight.label),
            Panel("run", "Run", "", tables.run_table(flight.metadata)),
            *_configuration("Configuration", sources, flight.path),
        ],
        warnings(flight, verdict),
    )  # fmt: skip


def fleet_page(fleet: Fleet, verdict: FleetVerdict, pages: Mapping[str, Path]) -> Page:
    """Return the page of a fleet; ``pages`` are those of the members, in the same folder."""
    from logs.report.figures import fleet_panels

    told = fleet.metadata.get(FLEET, {})
    sides = [
        Side(name, flight, verdict.members[name], fleet.shift_s(flight))
        for name, flight in fleet.flights.items()
    ]
    picture, *figures = fleet_panels(fleet, sides, pair_series(fleet))
    source = " and ".join(dict.fromkeys(SOURCES[each.judged_from] for each in verdict.members.values()))
    sources = [
        (f"Configuration of {name}", flight.attachments.get(ATTACHMENT), f"{name}.toml")
        for name, flight in fleet.flights.items()
    ]
    result = tables.members_table(sides, pages) + tables.fleet_result_table(verdict)
    return Page(
        told.get("scenario", fleet.path.stem),
        _fleet_headline(verdict),
        " · ".join([f"{len(verdict.members)} vehicles", *_flown(told), verdict.reason]),
        tables.fleet_key_numbers(verdict),
        [
            picture,
            Panel(
                "result", "Result",
                f"Judged from {source}. The fleet has landed when all its members have.", result,
            ),
            part("bar", True),
            *figures,
            [
                Panel("near", "How near they came", _NEAR, tables.pairs_table(fleet)),
                Panel("waits", "Who waited for whom", _WAITS, tables.waits_table(sides)),
            ],
            Panel(
                "events", "Events of all", "Times since the log began; each is a link.",
                tables.events_table(fleet.events), style=_EVENTS,
            ),
            repeat_section(fleet),
            Panel("run", "Run", "", tables.run_table(fleet.metadata)),
            *_configuration("Configurations", sources, fleet.path),
        ],
        _fleet_warnings(fleet, verdict),
    )  # fmt: skip


def _flown(run: Mapping[str, str]) -> list[str]:
    """Return seed, filter and mode of a run, if the log contains them."""
    named = [f"{key} {run[key]}" for key in ("seed", "filter") if key in run]
    return named + ([run["mode"]] if "mode" in run else [])


def _configuration(
    title: str, files: Sequence[tuple[str, bytes | None, str]], log: Path
) -> tuple[Panel, str]:
    """Return a panel with the attachments as text to open, and the end of the page."""
    texts = [
        details(what, data.decode(errors="replace"), name) for what, data, name in files if data is not None
    ]
    inner = html("".join(texts) or paragraph("The log holds none."))
    end = html("<footer>Log: {}. Frames: east, north, up; SI units.</footer>").format(log.name)
    return Panel("configuration", title, "", inner), end


def _fleet_headline(verdict: FleetVerdict) -> tuple[str, str]:
    text, style = tables.HEADLINES[verdict.outcome]
    text = "All landed" if verdict.outcome is Outcome.LANDED else text
    also = ["a barrier violation"] if verdict.violation else []
    also += ["an ellipsoid violation"] if verdict.ellipsoid_violations else []
    if also:
        return f"{text}, with {' and '.join(also)}", "fair" if style == "good" else style
    return text, style


def _source(verdict: Verdict) -> str:
    if verdict.judged_from == TRUTH:
        return (
            "Judged from the simulator's true states, sampled every physics step, "
            "independent of the controller's estimate."
        )
    return (
        f"Judged from {SOURCES[verdict.judged_from]}: this log holds no true states. "
        "An estimate shows neither contacts nor its own errors."
    )


def warnings(flight: Flight, verdict: Verdict) -> list[str]:
    texts = [*flight.problems]
    if outside := outside_envelope(flight):
        texts.append(f"outside the proven envelope: {outside}")
    if apart := judged_apart(flight):
        texts.append(apart)
    if flight.truth is None:
        texts.append("no true states in this log: all values are the vehicle's own estimate")
    if flight.steps is None:
        texts.append("no controller steps in this log: phases, velocities and the estimate are missing")
    if verdict.violation is None:
        texts.append("data is missing, so that a barrier violation cannot be excluded")
    return texts


def _fleet_warnings(fleet: Fleet, verdict: FleetVerdict) -> list[str]:
    texts = [
        f"{name}: {text}"
        for name, flight in fleet.flights.items()
        for text in warnings(flight, verdict.members[name])
    ]
    if not pairs_known(fleet):
        texts.append(
            "the simulator did not follow all pairs to the end: a collision or an ellipsoid violation cannot "
            "be excluded"
        )
    return texts


_VEHICLES = ("px4", "px4-sih", "ardupilot")


def command(run: Mapping[str, str], scenario: str) -> str:
    """Return the command that repeats a flight, from its metadata and its scenario's name or file."""
    parts = ["flightstack", "sitl", "--scenario", scenario, "--seed", run["seed"]]
    if "filter" in run:
        parts += ["--filter", run["filter"]]
    if run.get("mode") == "lockstep":
        parts.append("--lockstep")
    if run.get("vehicle") in _VEHICLES:
        parts += [f"--{run['vehicle']}", run.get("program", "PROGRAM")]
    return shlex.join(parts + repeated(run))


def repeat_section(of: Flight | Fleet, member: str = "") -> str:
    """Return the section with the commands that repeat a flight, or the reason why there are none.

    ``member``: name of the vehicle if it flew with others: then only the whole fleet can fly again.
    """
    run, whole = of.metadata.get("run", of.metadata.get(FLEET, {})), of.attachments.get(SCENARIO)
    again = ["flightstack", "replay", of.path.name, "--check"]
    if member:
        return part("repeat", replay=shlex.join([*again, "--member", member]), alone=False)
    if whole is None or "seed" not in run:
        return part("repeat", replay=shlex.join(again))
    by_name = "scenario" in run and "config" not in run
    return part(
        "repeat",
        replay=shlex.join(again),
        command=command(run, SCENARIO),
        revision=of.metadata.get("made", {}).get("git_revision", ""),
        lockstep=run.get("mode") == "lockstep",
        scenario=details("The scenario as it was flown", whole.decode(errors="replace"), SCENARIO),
        by_name=command(run, run["scenario"]) if by_name else "",
    )
