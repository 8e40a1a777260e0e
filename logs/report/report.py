"""The report of a flight: one HTML page that needs nothing else, no network either."""

from __future__ import annotations

import shlex
from html import escape
from pathlib import Path

import numpy as np

from logs.reader.flight import load_flight
from logs.reader.flight_data import Flight
from logs.report.page import ReportError, details, header, need_plotly, page, plotly_source, section
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
BAR = (
    '<div class="bar"><span>All times:</span><button data-range="landing">Landing</button>'
    '<button data-range="whole">Whole flight</button>'
    "<span>Time axes move together; an event's time is a link.</span></div>"
)


def write_report(log: Path, out: Path | None = None) -> Path:
    """Write the report of a log as one HTML page.

    Args:
        log: the flight log, whole or cut short.
        out: where to write; ``None`` puts it beside the log with the ending ``.html``.

    Returns:
        Where it is.

    Raises:
        LogError: the log cannot be used.
        ReportError: the plotting library is not installed.
    """
    flight = load_flight(log)
    return write_page(flight, judge(flight), out)


def write_page(flight: Flight, verdict: Verdict, out: Path | None = None) -> Path:
    """Write the report of a flight that was judged already; as :func:`write_report`.

    Raises:
        ReportError: the plotting library is not installed.
    """
    text = render(flight, verdict)
    target = flight.path.with_suffix(".html") if out is None else out
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    return target


def render(flight: Flight, verdict: Verdict) -> str:
    """Return the page as text.

    Raises:
        ReportError: the plotting library is not installed.
    """
    need_plotly()
    from logs.report.figures import panels
    from logs.report.links import load_streams

    run = flight.metadata.get("run", {})
    streams = load_streams(flight.path, flight.origin_ns)
    title = run.get("scenario", flight.path.stem)
    badge, style = headline(verdict)
    timeline, *drawn = panels(flight, verdict, streams)
    figures = {p.key: section(p.key, p.title, p.paper, p.note, p.figure) for p in (timeline, *drawn)}
    figures["age"] += _block(
        "links", "Links", "Counted from the recorded traffic.", links_table(streams) + ages_table(flight)
    )
    sources = "".join(
        details(what, flight.attachments[name].decode(errors="replace"), name)
        for name, what in _FILES
        if name in flight.attachments
    )
    body = (
        header(title, badge, style, _subtitle(run, verdict)),
        _warnings(flight, verdict),
        _block("result", "Result", _source(verdict), result_table(flight, verdict) + definitions()),
        BAR,
        figures.pop("timeline"),
        '<div class="columns">',
        _block("phases", "Phases", "Each with the reason it began.", phases_table(flight)),
        _block("faults", "Faults", _FAULTS, faults_table(flight)),
        "</div>",
        *figures.values(),
        _block("events", "Events", _EVENTS, events_table(flight), "wide events"),
        repeat_section(flight),
        '<div class="columns">',
        _block("run", "Run", "", run_table(flight)),
        _block("versions", "Versions", "", versions_table(flight)),
        "</div>",
        f"<section><h2>Configuration</h2>{sources or '<p>The log holds none.</p>'}</section>",
        f"<footer>{escape(f'Log: {flight.path.name}. Frames: east, north, up; SI units.')}</footer>",
    )
    return page(title, "".join(body))


def _block(key: str, title: str, note: str, content: str, style: str = "wide") -> str:
    said = f'<p class="note">{escape(note)}</p>' if note else ""
    return f'<section id="{key}"><h2>{escape(title)}</h2>{said}<div class="{style}">{content}</div></section>'


def _subtitle(run: dict[str, str], verdict: Verdict) -> str:
    told = [f"{name} {run[key]}" for key, name in (("seed", "seed"), ("filter", "filter")) if key in run]
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
    """What a reader has to know before trusting the page."""
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


def _warnings(flight: Flight, verdict: Verdict) -> str:
    texts = warnings(flight, verdict)
    if not texts:
        return ""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f'<section class="warning"><h2>Mind when reading</h2><ul>{items}</ul></section>'


def command(run: dict[str, str], scenario: str) -> str:
    """Command that flies a run again, from its metadata and the name or file of its scenario."""
    parts = ["flightstack", "sitl", "--scenario", scenario, "--seed", run["seed"]]
    if "filter" in run:
        parts += ["--filter", run["filter"]]
    if run.get("mode") == "lockstep":
        parts.append("--lockstep")
    return shlex.join(parts)


def repeat_section(flight: Flight) -> str:
    """The section with the commands; what cannot be repeated says why."""
    run, log = flight.metadata.get("run", {}), flight.path.name
    again = shlex.join(["flightstack", "replay", log, "--check"])
    parts = ["<p>Compute every decision again from the recorded inputs, and compare:</p>", _pre(again)]
    whole = flight.attachments.get(_SCENARIO)
    if whole is None or "seed" not in run:
        parts.append("<p>The log names no scenario and seed: this was no simulated run of ours.</p>")
    else:
        revision = flight.metadata.get("made", {}).get("git_revision", "")
        at = f" (code: {escape(revision)})" if revision else ""
        same = " The same seed then makes the same messages." if run.get("mode") == "lockstep" else ""
        first = [
            f"<p>Fly it again{at}, with the scenario as it was flown, saved from here.{same}</p>",
            _pre(command(run, _SCENARIO)),
            details("The scenario as it was flown", whole.decode(errors="replace"), _SCENARIO),
        ]
        if "scenario" in run:
            first.append("<p>The same by its name, while that scenario has not been changed:</p>")
            first.append(_pre(command(run, run["scenario"])))
        parts = first + parts
    return '<section id="repeat"><h2>Repeat this flight</h2>' + "".join(parts) + "</section>"


def _pre(text: str) -> str:
    return f"<pre>{escape(text)}</pre>"
