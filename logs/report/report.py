"""Makes the HTML report of a log: of all its flights, or of one of them."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path

from flightstack.config.options import repeated
from logs.reader.flight_data import ATTACHMENT, Fleet, Flight
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
from logs.verdict.types import ESTIMATE, RADIUS_ABOVE_M, RADIUS_BESIDE_M, SOURCES, TRUTH, Outcome
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
_PAIRS_UNKNOWN = (
    "the simulator did not follow all pairs to the end: a collision or an ellipsoid violation cannot be "
    "excluded"
)
_WAITS = "Times in which a member flew and gave way to neighbours, by its own messages."


def write_report(fleet: Fleet, verdict: FleetVerdict, out: Path | None = None) -> dict[str, Path]:
    """Write the pages of a log with its verdict, by default next to the log; return their paths by member.

    The key "" is the main page. Raises like ``logs.report.page.write``.
    """
    need_libraries()
    name = "report" if fleet.path.name == "flight.mcap" else fleet.path.stem  # as `sitl` and `fly` name it
    target = fleet.path.with_name(f"{name}.html") if out is None else out
    if len(fleet.flights) == 1:
        return {"": write(target, _flight_page(fleet, verdict, *fleet.flights))}
    pages = {
        name: target.with_name(f"{target.stem}_{name.replace('/', '_')}{target.suffix}")
        for name in fleet.flights
    }
    whole = part("paragraph", part("link", target.name, "The whole fleet"))
    for name, place in pages.items():
        write(place, _flight_page(fleet, verdict, name, label=name, top=whole))
    return {"": write(target, _fleet_page(fleet, verdict, pages)), **pages}


def _flight_page(fleet: Fleet, verdict: FleetVerdict, name: str, label: str = "", top: str = "") -> Page:
    """Return the page of one flight.

    ``label``: name of the vehicle in title and replay command; ``top``: HTML above all panels.
    """
    from logs.report.figures import panels

    flight, alone = fleet.flights[name], fleet_verdict({name: verdict.members[name]})
    side = Side(name, flight, alone.members[name], -(flight.landing_start_s or 0.0))
    title, about = _about(flight, fleet.path)
    picture, timeline, *figures = panels(side)
    return Page(
        title if label in title else f"{title}, {label}",
        tables.headline(alone),
        " · ".join([*about, alone.reason]),
        tables.key_numbers(alone, [side]),
        [
            top,
            picture,
            Panel("result", "Result", _source(alone), tables.result_table(alone, [side], {})),
            part("bar", True),
            timeline,
            *figures,
            _events(flight, "landing", -side.offset_s),
            repeat_section(flight, label),
            *_files(flight, [flight]),
        ],
        _warnings([flight], alone),
    )


def _fleet_page(fleet: Fleet, verdict: FleetVerdict, pages: Mapping[str, Path]) -> Page:
    """Return the page of all flights together; ``pages``: pages of the single flights, in the same folder."""
    from logs.report.figures import fleet_panels

    sides = [
        Side(name, flight, verdict.members[name], fleet.shift_s(flight))
        for name, flight in fleet.flights.items()
    ]
    title, about = _about(fleet, fleet.path)
    landed = f"{verdict.outcomes.count(Outcome.LANDED)} of {len(sides)}"
    nearest_m = tables.number(verdict.distance_min_m, 2)
    source = f"{_source(verdict)} The fleet has landed when all its members have."
    unknown = [] if pairs_known(fleet) else [_PAIRS_UNKNOWN]
    picture, timeline = fleet_panels(fleet, sides)
    return Page(
        title,
        tables.headline(verdict),
        " · ".join([f"{len(sides)} vehicles", *about, verdict.reason]),
        [
            ("landed", landed, ""),
            ("smallest distance of two vehicles", nearest_m, "m"),
            *tables.key_numbers(verdict, sides),
        ],
        [
            picture,
            Panel("result", "Result", source, tables.result_table(verdict, sides, pages)),
            part("bar", True),
            timeline,
            [
                Panel("near", "How near they came", _NEAR, tables.pairs_table(fleet)),
                Panel("waits", "Who waited for whom", _WAITS, tables.waits_table(sides)),
            ],
            _events(fleet, "log", 0.0),
            repeat_section(fleet),
            *_files(fleet, fleet.flights.values()),
        ],
        [*_warnings(fleet.flights.values(), verdict), *unknown],
    )


def _about(shown: Fleet | Flight, log: Path) -> tuple[str, list[str]]:
    """Return the title of a page, and the seed, filter and mode of its run."""
    run = _run(shown)
    about = [f"{key} {run[key]}" for key in ("seed", "filter") if key in run]
    return run.get("scenario", log.stem), about + ([run["mode"]] if "mode" in run else [])


def _run(shown: Fleet | Flight) -> Mapping[str, str]:
    return shown.metadata.get("run", shown.metadata.get(FLEET, {}))


def _events(shown: Fleet | Flight, since: str, zero_s: float) -> Panel:
    note = f"Times since the {since} began; each is a link."
    return Panel("events", "Events", note, tables.events_table(shown.events, zero_s), style="wide events")


def _files(shown: Fleet | Flight, flights: Iterable[Flight]) -> tuple[Panel, Panel, str]:
    """Return the panels of the run's metadata and of the attachments as text, and the footer of the page."""
    files = [
        (f"{flight.member}: Configuration of the onboard process", flight.attachments.get(ATTACHMENT),
         f"{flight.member}.{ATTACHMENT}")
        for flight in flights
    ]  # fmt: skip
    files.append(("Scenario, whole", shown.attachments.get(SCENARIO), SCENARIO))
    found = [(what, data.decode(errors="replace"), name) for what, data, name in files if data is not None]
    return (
        Panel("run", "Run", "", tables.run_table(shown.metadata)),
        Panel("configuration", "Configuration", "", part("files", found)),
        part("footer", shown.path.name),
    )


def _source(verdict: FleetVerdict) -> str:
    sources = dict.fromkeys(each.judged_from for each in verdict.members.values())
    text = f"Judged from {' and '.join(SOURCES[each] for each in sources)}. "
    if TRUTH in sources:
        text += "True states are sampled every physics step, independent of the controller's estimate. "
    if ESTIMATE in sources:
        text += "An estimate shows neither contacts nor its own errors. "
    return text.rstrip()


def _warnings(flights: Iterable[Flight], verdict: FleetVerdict) -> list[str]:
    texts = []
    for flight in flights:
        found = [*flight.problems]
        if outside := outside_envelope(flight):
            found.append(f"outside the proven envelope: {outside}")
        if apart := judged_apart(flight):
            found.append(apart)
        if flight.truth is None:
            found.append("no true states in this log: all values are the vehicle's own estimate")
        if flight.steps is None:
            found.append("no controller steps in this log: phases, velocities and the estimate are missing")
        if verdict.members[flight.member].violation is None:
            found.append("data is missing, so that a barrier violation cannot be excluded")
        texts += [f"{flight.member}: {text}" for text in found]
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


def repeat_section(shown: Fleet | Flight, member: str = "") -> str:
    """Return the section with the commands that repeat a flight, or the reason why there are none.

    ``member``: name of the vehicle if it flew in a fleet; only the whole fleet can fly again.
    """
    run, whole = _run(shown), shown.attachments.get(SCENARIO)
    again = ["flightstack", "replay", shown.path.name, "--check"]
    if member:
        return part("repeat", replay=shlex.join([*again, "--member", member]), alone=False)
    if whole is None or "seed" not in run:
        return part("repeat", replay=shlex.join(again))
    by_name = "scenario" in run and "config" not in run
    return part(
        "repeat",
        replay=shlex.join(again),
        command=command(run, SCENARIO),
        revision=shown.metadata.get("made", {}).get("git_revision", ""),
        lockstep=run.get("mode") == "lockstep",
        scenario=whole.decode(errors="replace"),
        by_name=command(run, run["scenario"]) if by_name else "",
    )
