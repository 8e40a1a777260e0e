"""The report of a flight: one HTML page that needs nothing else, no network either."""

from __future__ import annotations

from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path

import numpy as np

from logs.flight import load_flight
from logs.flight_data import Flight
from logs.report_tables import events_table, headline, result_table, run_table, versions_table
from logs.verdict import judge
from logs.verdict_types import TRUE_STATES, Verdict

_H_TOLERANCE_M = 1e-6  # the barrier we draw has to be the one the simulator judged by


class ReportError(RuntimeError):
    """The page cannot be made here; says what is missing."""


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
    page = render(flight, judge(flight))
    target = log.with_suffix(".html") if out is None else out
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page, encoding="utf-8")
    return target


def render(flight: Flight, verdict: Verdict) -> str:
    """Return the page as text."""
    try:
        from logs.figures import panels
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("plotly"):
            raise
        raise ReportError(
            'the report needs plotly, which is not installed: pip install "crazyflie-flightstack[report]"'
        ) from error
    run = flight.metadata.get("run", {})
    text, style = headline(verdict)
    drawn = panels(flight, verdict)
    values = {
        "TITLE": escape(run.get("scenario", flight.path.stem)),
        "STYLE": style,
        "HEADLINE": escape(text),
        "SUBTITLE": escape(_subtitle(run, verdict)),
        "WARNINGS": _warnings(flight, verdict),
        "SOURCE": escape(_source(verdict)),
        "RESULT": result_table(flight, verdict),
        "RUN": run_table(flight),
        "VERSIONS": versions_table(flight),
        "EVENTS": events_table(flight),
        "FOOTER": escape(f"Log: {flight.path.name}. Frames: east, north, up; SI units."),
        "FIGURES": "".join(_section(p.key, p.title, p.paper, p.note, p.figure) for p in drawn),
        "PLOTLY": _plotly(),
    }
    page = (files("logs") / "report_template.html").read_text(encoding="utf-8")
    parts = page.split("@@")  # text, NAME, text, NAME, ..., text
    parts[1::2] = [values[name] for name in parts[1::2]]
    return "".join(parts)


def _section(key: str, title: str, paper: str, note: str, figure: object | None) -> str:
    reference = f'<span class="paper">paper {escape(paper)}</span>' if paper else ""
    body = ""
    if figure is not None:
        # a "<" in a name could end the script element
        data = figure.to_json().replace("<", "\\u003c")  # type: ignore[attr-defined]
        body = (
            f'<div class="figure" id="figure-{key}"></div>'
            f'<script type="application/json" id="figure-{key}-data">{data}</script>'
        )
    note = note if figure is not None else f"Not drawn: the log has no usable data for this figure. {note}"
    return f'<section><h2>{escape(title)}{reference}</h2><p class="note">{escape(note)}</p>{body}</section>\n'


def _subtitle(run: dict[str, str], verdict: Verdict) -> str:
    told = [f"{name} {run[key]}" for key, name in (("seed", "seed"), ("filter", "filter")) if key in run]
    told += [run["mode"]] if "mode" in run else []
    return " · ".join([*told, verdict.reason])


def _source(verdict: Verdict) -> str:
    if verdict.judged_from == TRUE_STATES:
        return (
            "Judged from the simulator's true states, sampled every physics step, "
            "whatever the controller believed."
        )
    return (
        "Judged from the vehicle's own estimate: this log holds no true states. "
        "An estimate shows neither contacts nor its own errors."
    )


def _warnings(flight: Flight, verdict: Verdict) -> str:
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
    if not texts:
        return ""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f'<section class="warning"><h2>Mind when reading</h2><ul>{items}</ul></section>'


@cache
def _plotly() -> str:
    """The drawing library as text; it goes into the page whole."""
    text = (files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8")
    return text.replace("</script", "<\\/script")
