"""How to fly the same flight again, and how to compute its decisions again, as commands."""

from __future__ import annotations

import shlex
from html import escape

from logs.reader.flight_data import Flight
from logs.report.page import details

_SCENARIO = "scenario.toml"


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
