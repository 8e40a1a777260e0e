"""A flight log as a Rerun recording: scene, curves and events, with a layout made for landings.

Rerun opens the MCAP file itself, too, but draws neither markers nor odometry and lays nothing out.
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
from flightstack.core.types import Phase
from logs.derive.markers import FILTERED_COLOR, NOMINAL_COLOR, OWN_COLOR, TARGET_COLOR, Color
from logs.reader.flight import load_fleet
from logs.reader.reader import LogFile
from logs.schema.events import Severity
from logs.schema.names import FLEET
from logs.schema.rows import LogRow
from logs.verdict.pairs import PairSeries, pair_series
from logs.view.canvas import AXES, EVENTS, PHASE, RUN, Canvas, blueprint
from logs.view.fleet import MEMBER_COLORS, pairs
from logs.view.read import Floats, Ints, Seen, column, read, read_fleet, times
from logs.view.scene import TRUE_COLOR, VELOCITIES, rgba, scene, truth, velocities

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
        """Read the log."""
        self._members: dict[str, Seen]  # by name; of one flight "" alone
        self._events: list[tuple[int, LogRow]] = []  # of a fleet
        self._pairs: list[PairSeries] = []
        if LogFile(log, member).members:
            self._members, self._events = read_fleet(log)
            self._pairs = pair_series(load_fleet(log))
            name = LogFile(log).metadata()[FLEET].get("scenario", "fleet")
        else:
            self._members = {"": read(log, member)}
            name = self._members[""].run.get("scenario", "flight")
        self.problem = next(iter(self._members.values())).problem
        self._stream = rr.RecordingStream("flightstack")
        self._stream.send_recording_name(f"{name}: {log.name}")

    def save(self, out: Path) -> None:
        self._stream.save(out, default_blueprint=self._blueprint())
        origin_ns = min(seen.origin_ns for seen in self._members.values())
        for number, (name, seen) in enumerate(self._members.items()):
            color = MEMBER_COLORS[number % len(MEMBER_COLORS)] if name else OWN_COLOR
            draw(Canvas(self._stream, origin_ns, name, color), seen)
        if "" not in self._members:
            whole = Canvas(self._stream, origin_ns)
            events(whole, self._events)
            pairs(whole, self._pairs, origin_ns)
        self._stream.flush()
        self._stream.disconnect()

    def _blueprint(self) -> Any:
        """Look at the middle of what the vehicles and the targets did."""
        shown = [
            each
            for seen in self._members.values()
            for each in (
                column(seen.steps, "own_position_enu_m"),
                column(seen.steps, "target_position_enu_m"),
                column(seen.truths, "position_enu_m"),
            )
        ]
        points = np.concatenate([each.reshape(-1, 3) for each in shown])
        points = points[np.isfinite(points).all(axis=1)]
        members = [name for name in self._members if name]
        if not len(points):
            return blueprint((0.0, 0.0, 0.0), 1.0, members, pairs=bool(self._pairs))
        low, high = points.min(axis=0), points.max(axis=0)
        x, y, z = (float(v) for v in 0.5 * (low + high))
        return blueprint((x, y, z), float(np.linalg.norm(high - low)), members, pairs=bool(self._pairs))


def open_viewer(recording: Path, *, web: bool) -> int:
    """Show an ``.rrd`` file in Rerun until it is closed; its exit status."""
    program = viewer_program()
    # Rerun itself would listen to every network; what flew is for this machine.
    serving = ["--serve-web", "--port", "auto", "--web-viewer-port", "0"] if web else []  # free ports
    return subprocess.run([program, str(recording), "--bind", "127.0.0.1", *serving], check=False).returncode


def viewer_program() -> str:
    """Rerun's program."""
    beside = Path(sys.executable).with_name("rerun")  # of this environment, active or not
    program = str(beside) if beside.exists() else shutil.which("rerun")
    if program is None:
        raise FileNotFoundError(f"no program `rerun` at {beside} or in PATH; pip install rerun-sdk again")
    return program


def draw(canvas: Canvas, seen: Seen) -> None:
    """Send all of a flight, or the next piece of it."""
    for part in (scene, velocities, truth, _curves):
        part(canvas, seen)
    canvas.style(RUN, rr.TextDocument(_run_text(seen), media_type="text/markdown"))
    events(canvas, seen.events)


def _curves(canvas: Canvas, seen: Seen) -> None:
    if seen.truths:
        _curve(canvas, "/safety/h/true", times(seen.truths), column(seen.truths, "h_m"), TRUE_COLOR)
    steps = seen.steps
    if steps:
        at_ns = times(steps)
        apart_m = column(steps, "own_position_enu_m") - column(steps, "target_position_enu_m")
        apart_m[(column(steps, "own_valid") * column(steps, "target_valid")) == 0.0] = np.nan
        _curve(canvas, "/safety/h/zero", at_ns[[0, -1]], np.zeros(2), ZERO_COLOR)
        for entity, field, scale, color in _CURVES:
            _curve(canvas, entity, at_ns, scale * column(steps, field), color)
        _curve(canvas, "/distance/horizontal", at_ns, np.hypot(apart_m[:, 0], apart_m[:, 1]), OWN_COLOR)
        _curve(canvas, "/distance/height", at_ns, apart_m[:, 2], TARGET_COLOR)
        for name, field, color in VELOCITIES:
            vector = column(steps, field)
            if name == "command":
                vector[column(steps, "setpoint_sent") == 0.0] = np.nan
            for axis, values in zip(AXES, vector.T, strict=True):
                _curve(canvas, f"/velocity/{axis}/{name}", at_ns, values, color)
        _phases(canvas, seen)
    for name, color in (("lateness", NOMINAL_COLOR), ("exec", OWN_COLOR), ("solve", FILTERED_COLOR)):
        if seen.timings:
            at_ns, values = times(seen.timings), 1e3 * column(seen.timings, f"{name}_s")
            _curve(canvas, f"/loop/{name}", at_ns, values, color)


def _phases(canvas: Canvas, seen: Seen) -> None:
    phase = column(seen.steps, "phase").astype(int)
    before = np.concatenate(([-1 if canvas.phase is None else canvas.phase], phase[:-1]))
    begins = np.flatnonzero(phase != before)
    canvas.phase = int(phase[-1])
    names = [Phase(p).name if p in Phase._value2member_map_ else str(p) for p in phase[begins]]
    canvas.columns(PHASE, times(seen.steps)[begins], rr.StateChange.columns(state=names))


def events(canvas: Canvas, rows: Sequence[tuple[int, LogRow]]) -> None:
    if rows:
        texts = [f"{row.name}: {row.msg}" for _, row in rows]
        levels = [_LEVELS.get(row.level, "INFO") for _, row in rows]
        canvas.columns(EVENTS, times(rows), rr.TextLog.columns(text=texts, level=levels))


def _curve(canvas: Canvas, entity: str, at_ns: Ints, values: Floats, color: Color) -> None:
    """Send one curve; a gap where there is no number."""
    canvas.style(entity, rr.SeriesLines(colors=[rgba(color)], names=[entity.rpartition("/")[2]]))
    canvas.columns(entity, at_ns, rr.Scalars.columns(scalars=values))


def _run_text(seen: Seen) -> str:
    rows = [f"| {_words(key)} | {_words(value)} |" for key, value in seen.run.items()]
    rows = rows or ["| no metadata | |"]
    broken = f"\n\n**The log is broken:** {_words(seen.problem)}" if seen.problem else ""
    return "\n".join(["| run | |", "|---|---|", *rows]) + broken


def _words(text: str) -> str:
    """Text as words in Markdown."""
    return re.sub(r"([\\`*_{}\[\]()<>#+!|~-])", r"\\\1", one_line(text))
