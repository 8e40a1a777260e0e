"""The report of a flight: one HTML page that needs nothing else, no network either."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np

from logs.reader.flight import load_flight
from logs.reader.flight_data import Flight
from logs.report.page import (
    ReportError,
    block,
    details,
    header,
    html,
    need_libraries,
    page,
    paragraph,
    plotly_source,
    repeat_box,
    section,
    time_bar,
    warnings_box,
)
from logs.report.tables import (
    ages_table,
    definitions,
    events_table,
    faults_table,
    headline,
    links_table,
    phases_table,
    result_table,
    run_table,
    versions_table,
)
from logs.verdict.types import SOURCES, TRUTH, Verdict
from logs.verdict.verdict import judge

__all__ = ["ReportError", "plotly_source", "render", "section", "write_page", "write_report"]

_H_TOLERANCE_M = 1e-6  # the barrier we draw has to be the one the simulator judged by
_FILES = (("onboard.toml", "Configuration of the onboard process"), ("scenario.toml", "Scenario, whole"))
_SCENARIO = "scenario.toml"
_FAULTS = "Injected on purpose; in the figures a red strip on top."
_EVENTS = "Times since the landing began; each is a link."


def write_report(log: Path, out: Path | None = None) -> Path:
    """Write the report of a log as one HTML page.

    Returns:
        Where it is.
    """
    flight = load_flight(log)
    return write_page(flight, judge(flight), out)


def write_page(flight: Flight, verdict: Verdict, out: Path | None = None, of: str | None = None) -> Path:
    """Write the report of a judged flight, by default beside its log; ``of`` is the page of its fleet."""
    text = render(flight, verdict, of)
    name = flight.path.stem if flight.member is None else f"{flight.path.stem}_{flight.member}"
    target = out if out is not None else flight.path.with_name(f"{name}.html")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    return target


def render(flight: Flight, verdict: Verdict, of: str | None = None) -> str:
    """Return the page as text, with a link to the page ``of`` its fleet."""
    need_libraries()
    from logs.report.figures import panels
    from logs.report.links import load_streams

    run = flight.metadata.get("run", {})
    streams = load_streams(flight.path, flight.origin_ns, flight.member)
    title = run.get("scenario", flight.path.stem)
    if flight.member is not None and flight.member not in title:
        title = f"{title}, {flight.member}"
    badge, style = headline(verdict)
    timeline, *drawn = panels(flight, verdict, streams)
    figures = {p.key: section(p.key, p.title, p.paper, p.note, p.figure) for p in (timeline, *drawn)}
    figures["age"] += block(
        "links", "Links", "Counted from the recorded traffic.", links_table(streams) + ages_table(flight)
    )
    sources = [
        details(what, flight.attachments[name].decode(errors="replace"), name)
        for name, what in _FILES
        if name in flight.attachments
    ]
    body = (
        header(title, badge, style, _subtitle(run, verdict)),
        html('<p><a href="{}">The whole fleet</a></p>').format(of) if of is not None else "",
        warnings_box(warnings(flight, verdict)),
        block("result", "Result", _source(verdict), result_table(flight, verdict) + definitions()),
        time_bar(events=True),
        figures.pop("timeline"),
        '<div class="columns">',
        block("phases", "Phases", "Each with the reason it began.", phases_table(flight)),
        block("faults", "Faults", _FAULTS, faults_table(flight)),
        "</div>",
        *figures.values(),
        block("events", "Events", _EVENTS, events_table(flight), "wide events"),
        repeat_section(flight),
        '<div class="columns">',
        block("run", "Run", "", run_table(flight)),
        block("versions", "Versions", "", versions_table(flight.metadata)),
        "</div>",
        "<section><h2>Configuration</h2>",
        *(sources or [paragraph("The log holds none.")]),
        "</section>",
        html("<footer>Log: {}. Frames: east, north, up; SI units.</footer>").format(flight.path.name),
    )
    return page(title, "".join(body))


def _subtitle(run: dict[str, str], verdict: Verdict) -> str:
    told = [f"{key} {run[key]}" for key in ("seed", "filter") if key in run]
    told += [run["mode"]] if "mode" in run else []
    return " · ".join([*told, verdict.reason])


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


_OPTIONS = {
    "autopilot": "--autopilot", "speed": "--speed", "duration_s": "--duration",
    "signing_key": "--signing-key",
}  # fmt: skip
_FLAGS = {"accept_release": "--accept-release", "mocap": "--mocap"}
_VEHICLES = ("px4", "px4-sih", "ardupilot")


def command(run: dict[str, str], scenario: str) -> str:
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
    """The section with the commands; what cannot be repeated says why."""
    run = flight.metadata.get("run", {})
    again = ["flightstack", "replay", flight.path.name, "--check"]
    if flight.member is not None:  # it flies again with its fleet alone
        return repeat_box(replay=shlex.join([*again, "--member", flight.member]), alone=False)
    whole = flight.attachments.get(_SCENARIO)
    if whole is None or "seed" not in run:
        return repeat_box(replay=shlex.join(again))
    return repeat_box(
        replay=shlex.join(again),
        command=command(run, _SCENARIO),
        revision=flight.metadata.get("made", {}).get("git_revision", ""),
        lockstep=run.get("mode") == "lockstep",
        scenario=details("The scenario as it was flown", whole.decode(errors="replace"), _SCENARIO),
        by_name=command(run, run["scenario"]) if "scenario" in run and "config" not in run else "",
    )
