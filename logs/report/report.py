"""The report of a log as HTML pages that need nothing else: of a flight, of two compared, of a fleet."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from logs.reader.fleet_messages import FleetMessages, load_messages
from logs.reader.flight_data import ATTACHMENT, Fleet, Flight
from logs.reader.reader import LogFile
from logs.report.derived import Side
from logs.report.page import (
    ReportError,
    block,
    details,
    header,
    html,
    need_libraries,
    numbers,
    page,
    paragraph,
    plotly_source,
    repeat_box,
    section,
    time_bar,
    warnings_box,
)
from logs.report.tables import (
    HEADLINES,
    ages_table,
    compared_key_numbers,
    compared_numbers,
    compared_settings,
    definitions,
    events_table,
    faults_table,
    fleet_key_numbers,
    fleet_result_table,
    headline,
    key_numbers,
    links_table,
    members_table,
    messages_table,
    pairs_table,
    phases_table,
    result_table,
    run_table,
    versions_table,
    waits_table,
)
from logs.schema.names import FLEET, TEAM
from logs.verdict.types import RADIUS_BESIDE_M, SOURCES, TRUTH, Outcome, Verdict
from logs.verdict.verdict import FleetVerdict, PairSeries, judged, pair_series, pairs_known

if TYPE_CHECKING:
    from logs.report.figures import Panel

__all__ = ["ReportError", "plotly_source", "section", "write_comparison", "write_page", "write_report"]

_H_TOLERANCE_M = 1e-6  # the barrier we draw has to be the one the simulator judged by
_SCENARIO = "scenario.toml"
_FILES = ((ATTACHMENT, "Configuration of the onboard process"), (_SCENARIO, "Scenario, whole"))
_FAULTS = "Injected on purpose; in the figures a red strip on top."
_NEAR = "Judged every physics step, while both flew."
_SETTINGS = "Run, versions and configuration."
_EVENTS = "Times since the landing began; each is a link."
_WIDE = "wide events"  # style of the tables of events
_TICK_S = 0.011  # true states are this far apart; the ellipsoid is judged every millisecond
_SPEED_M_S = 4.0  # at which two vehicles may come nearer between two of them
_EQUAL = 1e-3  # of the measure: a true state between two ticks is not in the log
_WAITS = "Times in which a member flew and gave way to neighbours, by its own messages."
_WAYS = (
    "Used: messages that a tick of the receiver used. The others were lost, or a newer one replaced them. "
    "Silent: time beyond the maximum age of a message, while the sender flew."
)


def write_report(fleet: Fleet, verdict: FleetVerdict, out: Path | None = None) -> dict[str, Path]:
    """Write the pages of a judged log, by default beside it; by name of the member, the main page by "".

    Raises ReportError: the plotting library is not installed.
    """
    if "" in fleet.flights:
        return {"": write_page(fleet.flights[""], verdict.members[""], out)}
    need_libraries()
    target = fleet.path.with_suffix(".html") if out is None else out
    members = {name: target.with_name(f"{target.stem}_{name}{target.suffix}") for name in fleet.flights}
    for name, place in members.items():
        write_page(fleet.flights[name], verdict.members[name], place, of=target.name)
    return {"": _written(target, render_fleet(fleet, verdict, members)), **members}


def write_page(flight: Flight, verdict: Verdict, out: Path | None = None, of: str | None = None) -> Path:
    """Write the page of a judged flight, by default beside its log; ``of`` is the page of its fleet."""
    name = flight.path.stem if flight.member is None else f"{flight.path.stem}_{flight.member}"
    target = out if out is not None else flight.path.with_name(f"{name}.html")
    return _written(target, render(flight, verdict, of))


def write_comparison(log_a: Path, log_b: Path, out: Path | None = None, member: str | None = None) -> Path:
    """Write the page that compares two logs, by default ``comparison.html`` beside the second."""
    need_libraries()
    target = log_b.with_name("comparison.html") if out is None else out
    return _written(target, _comparison(_side("A", log_a, member), _side("B", log_b, member)))


def _written(target: Path, text: str) -> Path:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    return target


def render(flight: Flight, verdict: Verdict, of: str | None = None) -> str:
    """Return the report of a flight as HTML; ``of``: its fleet's page, to which the report links."""
    need_libraries()
    from logs.report.derived import load_streams
    from logs.report.figures import panels

    run = flight.metadata.get("run", {})
    streams = load_streams(flight.path, flight.origin_ns, flight.member)
    title = run.get("scenario", flight.path.stem)
    if flight.member is not None and flight.member not in title:
        title = f"{title}, {flight.member}"
    timeline, picture, *figures = (_drawn(panel) for panel in panels(flight, verdict, streams))
    sub = [f"{key} {run[key]}" for key in ("seed", "filter") if key in run]
    sub += [run["mode"]] if "mode" in run else []
    sources = [(what, flight.attachments.get(name), name) for name, what in _FILES]
    links = links_table(streams) + ages_table(flight)
    return page(title, "".join((
        header(title, *headline(verdict), " · ".join([*sub, verdict.reason])),
        html('<p><a href="{}">The whole fleet</a></p>').format(of) if of is not None else "",
        warnings_box(warnings(flight, verdict)),
        numbers(key_numbers(verdict)),
        picture,
        block("result", "Result", _source(verdict), result_table(flight, verdict) + definitions()),
        time_bar(events=True),
        timeline,
        '<div class="columns">',
        block("phases", "Phases", "Each with the reason it began.", phases_table(flight)),
        block("faults", "Faults", _FAULTS, faults_table(flight)),
        "</div>",
        *figures,
        block("links", "Links", "Counted from the recorded traffic.", links),
        block("events", "Events", _EVENTS, events_table(flight.events, flight.landing_start_s or 0.0), _WIDE),
        repeat_section(flight),
        '<div class="columns">',
        block("run", "Run", "", run_table(flight)),
        block("versions", "Versions", "", versions_table(flight.metadata)),
        "</div>",
        *_configuration("Configuration", sources, flight.path),
    )))  # fmt: skip


def render_fleet(fleet: Fleet, verdict: FleetVerdict, pages: Mapping[str, Path]) -> str:
    """Return the page of a fleet as text; ``pages`` are those of the members, in the same folder."""
    from logs.report.figures import fleet_panels

    told = fleet.metadata.get(FLEET, {})
    title = told.get("scenario", fleet.path.stem)
    words, pairs = load_messages(fleet), pair_series(fleet)
    sub = [f"{len(verdict.members)} vehicles", *([f"seed {told['seed']}"] if "seed" in told else [])]
    sub += [told["mode"]] if "mode" in told else []
    source = " and ".join(dict.fromkeys(SOURCES[each.judged_from] for each in verdict.members.values()))
    source = f"Judged from {source}. The fleet has landed when all its members have."
    sources = [
        (f"Configuration of {name}", flight.attachments.get(ATTACHMENT), f"{name}.toml")
        for name, flight in fleet.flights.items()
    ]
    events = "Times since the log began; each is a link."
    picture, *figures = map(_drawn, fleet_panels(fleet, words, pairs))
    return page(title, "".join((
        header(title, *_fleet_headline(verdict), " · ".join([*sub, verdict.reason])),
        warnings_box(_fleet_warnings(fleet, verdict, words, pairs)),
        numbers(fleet_key_numbers(verdict)),
        picture,
        block(
            "result", "Result", source, members_table(verdict, words, pages) + fleet_result_table(verdict)
        ),
        time_bar(events=True),
        *figures,
        '<div class="columns">',
        block("near", "How near they came", _NEAR, pairs_table(fleet)),
        block("waits", "Who waited for whom", _WAITS, waits_table(words)),
        "</div>",
        block("words", "Messages between members", _WAYS, messages_table(words)),
        block("events", "Events of all", events, events_table(fleet.events), _WIDE),
        _repeat(fleet.path, told, fleet.metadata, fleet.attachments.get(TEAM), TEAM),
        block("versions", "Versions", "", versions_table(fleet.metadata)),
        *_configuration("Configurations", sources, fleet.path),
    )))  # fmt: skip


def _comparison(a: Side, b: Side) -> str:
    """Return the page of two flights as text."""
    from logs.report.figures import compared_panels

    worse = max((headline(s.verdict)[1] for s in (a, b)), key=("good", "fair", "bad").index)
    title = f"{_scenario(a)} and {_scenario(b)}, compared"
    outcomes = " · ".join(f"{s.name} {headline(s.verdict)[0]}" for s in (a, b))
    picture, *figures = map(_drawn, compared_panels((a, b)))
    events = [
        block(f"events-{s.name}", f"Events of {s.name}", "",
              events_table(s.flight.events, s.flight.landing_start_s or 0.0), _WIDE)
        for s in (a, b)
    ]  # fmt: skip
    return page(title, "".join((
        header(title, outcomes, worse, " · ".join(_about(s) for s in (a, b))),
        warnings_box([f"{s.name}: {text}" for s in (a, b) for text in warnings(s.flight, s.verdict)]),
        numbers(compared_key_numbers(a.verdict, b.verdict)),
        picture,
        block("numbers", "Key numbers", "", compared_numbers(a, b) + definitions()),
        block("settings", "What was set differently", _SETTINGS, compared_settings(a.flight, b.flight)),
        time_bar(events=False),
        *figures,
        '<div class="columns">', *events, "</div>",
    )))  # fmt: skip


def _side(name: str, log: Path, member: str | None) -> Side:
    from logs.report.derived import load_streams

    member = member if LogFile(log).members else None  # the other log may be that of a single flight
    LogFile(log, member).single()
    fleet, verdict = judged(log, member)
    flight = fleet.flights[""]
    return Side(name, flight, verdict.members[""], load_streams(flight.path, flight.origin_ns, flight.member))


def _scenario(side: Side) -> str:
    return side.flight.metadata.get("run", {}).get("scenario", side.flight.path.stem)


def _about(side: Side) -> str:
    run = side.flight.metadata.get("run", {})
    shown = [f"{key} {run[key]}" for key in ("seed", "filter", "mode") if key in run]
    return ", ".join([f"{side.name}: {side.flight.path}", *shown])


def _drawn(panel: Panel) -> str:
    return section(panel.key, panel.title, panel.paper, panel.note, panel.figure)


def _configuration(title: str, files: Sequence[tuple[str, bytes | None, str]], log: Path) -> tuple[str, ...]:
    """Attachments as text to open, and the end of the page."""
    texts = [
        details(what, data.decode(errors="replace"), name) for what, data, name in files if data is not None
    ]
    inner = "".join(texts) or paragraph("The log holds none.")
    return (
        html("<section><h2>{}</h2>{}</section>").format(title, html(inner)),
        html("<footer>Log: {}. Frames: east, north, up; SI units.</footer>").format(log.name),
    )


def _fleet_headline(verdict: FleetVerdict) -> tuple[str, str]:
    text, style = HEADLINES[verdict.outcome]
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
            "whatever the controller believed."
        )
    return (
        f"Judged from {SOURCES[verdict.judged_from]}: this log holds no true states. "
        "An estimate shows neither contacts nor its own errors."
    )


def warnings(flight: Flight, verdict: Verdict) -> list[str]:
    texts = [*flight.problems]
    if flight.truth is None:
        texts.append("no true states in this log: everything here is the vehicle's own estimate")
    if flight.steps is None:
        texts.append("no controller steps in this log: phases, velocities and the estimate are missing")
    if verdict.violation is None:
        texts.append("data is missing, so that a barrier violation cannot be excluded")
    if flight.barrier is not None and flight.truth is not None:
        from_page = np.array(
            [flight.barrier.h((float(x), float(y), float(z))) for x, y, z in flight.truth.e_m[::50]]
        )
        differs = np.abs(from_page - flight.truth.h_m[::50])
        if np.nanmax(differs, initial=0.0) > _H_TOLERANCE_M:
            texts.append("the boundary drawn here is not the one the simulator computed h with")
    return texts


def _fleet_warnings(
    fleet: Fleet, verdict: FleetVerdict, words: FleetMessages, series: Sequence[PairSeries]
) -> list[str]:
    texts = [
        f"{name}: {text}"
        for name, flight in fleet.flights.items()
        for text in warnings(flight, verdict.members[name])
    ]
    texts += words.problems
    if not pairs_known(fleet):
        texts.append(
            "the simulator did not follow all pairs to the end: a collision or an ellipsoid violation cannot "
            "be excluded"
        )
    drawn = min(
        (float(np.min(pair.measure[pair.flying])) for pair in series if pair.flying.any()), default=None
    )
    if drawn is not None and verdict.ellipsoid_min is not None:
        passed = _SPEED_M_S * _TICK_S / (2.0 * RADIUS_BESIDE_M)
        if not -_EQUAL <= drawn - verdict.ellipsoid_min <= passed:
            texts.append("the ellipsoid drawn here is not the one that the simulator judged by")
    return texts


_OPTIONS = {
    "autopilot": "--autopilot", "speed": "--speed", "duration_s": "--duration",
    "signing_key": "--signing-key",
}  # fmt: skip
_FLAGS = {"accept_release": "--accept-release", "mocap": "--mocap"}
_VEHICLES = ("px4", "px4-sih", "ardupilot")


def command(run: Mapping[str, str], scenario: str) -> str:
    """Command that flies a run again, from its metadata and the name or file of its scenario."""
    parts = ["flightstack", "sitl", "--scenario", scenario, "--seed", run["seed"]]
    if "filter" in run:
        parts += ["--filter", run["filter"]]
    if run.get("mode") == "lockstep":
        parts.append("--lockstep")
    if run.get("vehicle") in _VEHICLES:
        parts += [f"--{run['vehicle']}", run.get("program", "PROGRAM")]
    for key, option in _OPTIONS.items():
        parts += [option, run[key]] if key in run else []
    parts += [option for key, option in _FLAGS.items() if run.get(key) == "true"]
    return shlex.join(parts)


def repeat_section(flight: Flight) -> str:
    """The section with the commands that repeat a flight, or the reason why none can."""
    whole, run = flight.attachments.get(_SCENARIO), flight.metadata.get("run", {})
    return _repeat(flight.path, run, flight.metadata, whole, _SCENARIO, flight.member)


def _repeat(
    log: Path,
    run: Mapping[str, str],
    metadata: Mapping[str, Mapping[str, str]],
    whole: bytes | None,
    name: str,
    member: str | None = None,
) -> str:
    again = ["flightstack", "replay", log.name, "--check"]
    if member is not None:  # it flies again with its fleet alone
        return repeat_box(replay=shlex.join([*again, "--member", member]), alone=False)
    if whole is None or "seed" not in run:
        return repeat_box(replay=shlex.join(again))
    by_name = name == _SCENARIO and "scenario" in run and "config" not in run
    title = "The team as it was flown" if name == TEAM else "The scenario as it was flown"
    return repeat_box(
        replay=shlex.join(again),
        command=command(run, name),
        revision=metadata.get("made", {}).get("git_revision", ""),
        lockstep=run.get("mode") == "lockstep",
        scenario=details(title, whole.decode(errors="replace"), name),
        by_name=command(run, run["scenario"]) if by_name else "",
    )
