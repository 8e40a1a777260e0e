"""Converts a flight log into a Rerun recording: scene, curves and events, with a layout for landings.

Rerun can open the MCAP file directly, too, but draws neither markers nor odometry and has no layout.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from flightstack.common.text import one_line
from logs.derive.markers import COLORS, FILTERED_COLOR, NOMINAL_COLOR, OWN_COLOR, TARGET_COLOR, Color
from logs.reader.flight import load_fleet
from logs.reader.flight_data import Event, Flight, Floats, Ints, phase_name
from logs.schema.events import Severity
from logs.schema.names import FLEET
from logs.view.canvas import AXES, EVENTS, PHASE, RUN, Canvas, blueprint, rgba, run_of, times
from logs.view.scene import TRUE_COLOR, VELOCITIES, scene, truth, velocities

ZERO_COLOR: Color = (0.84, 0.15, 0.16, 1.0)
_LEVELS: dict[int, str] = {
    Severity.DEBUG: "DEBUG",
    Severity.INFO: "INFO",
    Severity.WARN: "WARN",
    Severity.ERROR: "ERROR",
    Severity.FATAL: "CRITICAL",
}
# Curves of the controller steps: entity, field, factor, colour.
_CURVES = (
    ("/safety/h/controller", "h_m", 1.0, OWN_COLOR),
    ("/safety/slack", "slack_m_s", 1.0, OWN_COLOR),
    ("/safety/dh_dt", "dh_dt_m_s", 1.0, OWN_COLOR),
    ("/safety/active", "barrier_active", 1.0, OWN_COLOR),
    ("/age/own", "own_age_s", 1e3, OWN_COLOR),
    ("/age/target", "target_age_s", 1e3, TARGET_COLOR),
    ("/samples/accepted", "target_accepted", 1.0, FILTERED_COLOR),
    ("/samples/rejected", "target_rejected", 1.0, ZERO_COLOR),
)


class Recording:
    def __init__(self, log: Path, member: str | None = None) -> None:
        self._fleet = load_fleet(log, member)
        first = next(iter(self._fleet.flights.values()))
        self.problem = "; ".join(first.damage)
        told = self._fleet.metadata.get(FLEET, run_of(first))
        self._stream = rr.RecordingStream("flightstack")
        self._stream.send_recording_name(f"{told.get('scenario', 'flight')}: {log.name}")

    def save(self, out: Path) -> None:
        self._stream.save(out, default_blueprint=self._blueprint())
        fleet = self._fleet
        for number, flight in enumerate(fleet.flights.values()):
            color = COLORS[number % len(COLORS)] if flight.label else OWN_COLOR
            draw(Canvas(self._stream, fleet.origin_ns, flight.label, color), flight)
        events(Canvas(self._stream, fleet.origin_ns), fleet.origin_ns, fleet.events)
        self._stream.flush()
        self._stream.disconnect()

    def _blueprint(self) -> Any:
        """Place the camera at the centre of the paths of vehicles and targets."""
        flights = self._fleet.flights
        shown: list[Floats] = []
        for flight in flights.values():
            if flight.steps is not None:
                shown += (flight.steps.own_position_enu_m, flight.steps.target_position_enu_m)
            if flight.truth is not None:
                shown.append(flight.truth.position_enu_m)
        points = np.concatenate(shown)
        points = points[np.isfinite(points).all(axis=1)]
        members = [flight.label for flight in flights.values() if flight.label]
        if not len(points):
            return blueprint((0.0, 0.0, 0.0), 1.0, members)
        low, high = points.min(axis=0), points.max(axis=0)
        x, y, z = (float(v) for v in 0.5 * (low + high))
        return blueprint((x, y, z), float(np.linalg.norm(high - low)), members)


def open_viewer(recording: Path, *, web: bool) -> int:
    """Show an ``.rrd`` file in Rerun until it is closed; return the exit status."""
    program = viewer_program()
    # Rerun itself would listen on every network; the flight is shown only on this machine.
    serving = ["--serve-web", "--port", "auto", "--web-viewer-port", "0"] if web else []  # with free ports
    return subprocess.run([program, str(recording), "--bind", "127.0.0.1", *serving], check=False).returncode


def viewer_program() -> str:
    """Return the path of Rerun's program."""
    beside = Path(sys.executable).with_name("rerun")  # program of this environment, active or not
    program = str(beside) if beside.exists() else shutil.which("rerun")
    if program is None:
        raise FileNotFoundError(f"no program `rerun` at {beside} or in PATH; pip install rerun-sdk again")
    return program


def draw(canvas: Canvas, flight: Flight) -> None:
    """Send a complete flight, or its next part, to the viewer."""
    for part in (scene, velocities, truth, _curves):
        part(canvas, flight)
    canvas.style(RUN, rr.TextDocument(_run_text(flight), media_type="text/markdown"))


def _curves(canvas: Canvas, flight: Flight) -> None:
    steps, true, timing = flight.steps, flight.truth, flight.timing
    if true is not None:
        _curve(canvas, "/safety/h/true", times(flight.origin_ns, true.t_s), true.h_m, TRUE_COLOR)
    if steps is not None:
        at_ns = times(flight.origin_ns, steps.t_s)
        apart_m = steps.own_position_enu_m - steps.target_position_enu_m
        apart_m[~(steps.own_valid & steps.target_valid)] = np.nan
        _curve(canvas, "/safety/h/zero", at_ns[[0, -1]], np.zeros(2), ZERO_COLOR)
        for entity, field, scale, color in _CURVES:
            _curve(canvas, entity, at_ns, scale * getattr(steps, field), color)
        _curve(canvas, "/distance/horizontal", at_ns, np.hypot(apart_m[:, 0], apart_m[:, 1]), OWN_COLOR)
        _curve(canvas, "/distance/height", at_ns, apart_m[:, 2], TARGET_COLOR)
        for name, field, color in VELOCITIES:
            vector = getattr(steps, field)
            if name == "command":
                vector = np.where(steps.setpoint_sent[:, None], vector, np.nan)
            for axis, values in zip(AXES, vector.T, strict=True):
                _curve(canvas, f"/velocity/{axis}/{name}", at_ns, values, color)
        _phases(canvas, at_ns, steps.phase)
    if timing is not None:
        for name, color in (("lateness", NOMINAL_COLOR), ("exec", OWN_COLOR), ("solve", FILTERED_COLOR)):
            values = 1e3 * getattr(timing, f"{name}_s")
            _curve(canvas, f"/loop/{name}", times(flight.origin_ns, timing.t_s), values, color)


def _phases(canvas: Canvas, at_ns: Ints, phase: Ints) -> None:
    before = np.concatenate(([-1 if canvas.phase is None else canvas.phase], phase[:-1]))
    begins = np.flatnonzero(phase != before)
    canvas.phase = int(phase[-1])
    names = [phase_name(number) for number in phase[begins].tolist()]
    canvas.columns(PHASE, at_ns[begins], rr.StateChange.columns(state=names))


def events(canvas: Canvas, origin_ns: int, said: Sequence[Event]) -> None:
    if said:
        texts = [f"{event.source}: {event.text}" for event in said]
        levels = [_LEVELS.get(event.level, "INFO") for event in said]
        at_ns = times(origin_ns, np.array([event.t_s for event in said]))
        canvas.columns(EVENTS, at_ns, rr.TextLog.columns(text=texts, level=levels))


def _curve(canvas: Canvas, entity: str, at_ns: Ints, values: Floats, color: Color) -> None:
    """Send one curve, with a gap for each unknown number."""
    canvas.style(entity, rr.SeriesLines(colors=[rgba(color)], names=[entity.rpartition("/")[2]]))
    canvas.columns(entity, at_ns, rr.Scalars.columns(scalars=values))


def _run_text(flight: Flight) -> str:
    rows = [f"| {_words(key)} | {_words(value)} |" for key, value in run_of(flight).items()]
    rows = rows or ["| no metadata | |"]
    broken = f"\n\n**The log is broken:** {_words('; '.join(flight.damage))}" if flight.damage else ""
    return "\n".join(["| run | |", "|---|---|", *rows]) + broken


def _words(text: str) -> str:
    """Escape a text for Markdown."""
    return re.sub(r"([\\`*_{}\[\]()<>#+!|~-])", r"\\\1", one_line(text))
