"""Shows running flights in Rerun: the figures of ``view``, made from the rows received so far."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import time
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from urllib.parse import quote

import numpy as np
import rerun as rr

from flightstack.common.processes import Port, ended, tied
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Phase
from logs.reader.flight import columns, since
from logs.reader.flight_data import Event, Flight, Floats, Steps, Timing, phase_name
from logs.recorder.markers import COLORS
from logs.schema.events import CONTROLLER, Severity
from logs.schema.rows import ControllerStepRow, LoopTimingRow
from logs.view.view import Canvas, blueprint, draw, events, viewer_program

NATIVE, WEB = "native", "web"
ENDING = ".rrd"
VIEWER_TIME_MAX_S = 2.0  # maximum wait for the viewer, s; then the flight starts without it
FLUSH_TIME_MAX_S = 2.0  # maximum wait until the viewer has received the last rows, s
MEMORY_LIMIT = "512MB"  # memory limit of the viewer, and of the server; the oldest data are dropped first


class LiveRecording:
    """Rerun recording of running flights; each call of ``add`` adds newer data of one flight."""

    def __init__(self, where: str, configs: Mapping[str, FlightConfig | None]) -> None:
        """Open the view of vehicles with these names; no configuration: no boundary h = 0 is drawn."""
        self._configs = configs
        self._stream = rr.RecordingStream("flightstack")
        self._stream.send_recording_name(", ".join(configs))
        self._events: Canvas | None = None  # None: no data have arrived
        self._canvases: dict[str, Canvas] = {}  # canvases of all vehicles by name
        self._phases: dict[str, int] = {}  # newest phase by name of the vehicle
        self._viewer: subprocess.Popen[bytes] | None = None
        self._stays = where == NATIVE  # whether the window stays open until the user closes it
        self.address = where  # address of the web page with the view, or path of the recording
        if where == NATIVE:
            self._start("--hide-welcome-screen")
        elif where == WEB:
            pages = Port()
            at = self._start("--serve-web", "--web-viewer-port", str(pages.number))
            pages.close()
            _wait_for(pages.number)
            self.address = f"http://127.0.0.1:{pages.number}/?url={quote(at, safe='')}"
        else:
            self._stream.save(_new(Path(where)))

    @property
    def closed(self) -> bool:
        return self._viewer is not None and self._viewer.poll() is not None

    def add(
        self, name: str, steps: Sequence[ControllerStepRow], timings: Sequence[LoopTimingRow],
        reason: str = "",
    ) -> None:  # fmt: skip
        if not steps:
            return
        if self._events is None:
            first_ns, colors = steps[0].stamp_ns, cycle(COLORS)
            self._events = Canvas(self._stream, first_ns)
            self._canvases = {
                each: Canvas(self._stream, first_ns, each, next(colors)) for each in self._configs
            }
            self._stream.send_blueprint(blueprint(list(self._configs)))
        origin_ns, end_ns = steps[0].stamp_ns, steps[-1].stamp_ns
        piece = Flight(
            path=Path(),
            origin_ns=origin_ns,
            duration_s=(end_ns - origin_ns) * 1e-9,
            steps=columns(Steps, steps, _since(origin_ns, steps)),
            timing=columns(Timing, timings, _since(origin_ns, timings)) if timings else None,
            events=tuple(self._entered(name, origin_ns, steps, reason)),
            config=self._configs[name],
        )
        draw(self._canvases[name], piece)
        events(self._events, origin_ns, piece.events)

    def close(self) -> None:
        """End the recording and the server of the web viewer, in bounded time."""
        with contextlib.suppress(RuntimeError):  # the viewer may not accept the last rows
            self._stream.flush(timeout_sec=FLUSH_TIME_MAX_S)
        self._stream.disconnect()
        if self._viewer is not None and not self._stays:
            ended(self._viewer)

    def _start(self, *words: str) -> str:
        """Start Rerun and send the recording there; return the address, which only this machine can reach."""
        port = Port()  # a free local port; by default Rerun uses a fixed port on all network interfaces
        program = [
            viewer_program(), "--bind", "127.0.0.1", "--port", str(port.number), *words,
            "--memory-limit", MEMORY_LIMIT, "--server-memory-limit", MEMORY_LIMIT, "--expect-data-soon",
        ]  # fmt: skip
        self._viewer = subprocess.Popen(
            program if self._stays else tied(program),  # a server also ends if this process is killed
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=self._stays,
        )
        port.close()
        _wait_for(port.number)
        at = f"rerun+http://127.0.0.1:{port.number}/proxy"
        self._stream.connect_grpc(at)
        return at

    def _entered(
        self, name: str, origin_ns: int, steps: Sequence[ControllerStepRow], reason: str
    ) -> list[Event]:
        """Return the phases that began since the last call; the reason belongs to the newest phase."""
        before = [self._phases.get(name), *(row.phase for row in steps)]
        self._phases[name] = steps[-1].phase
        begun = [row for row, phase in zip(steps, before, strict=False) if row.phase != phase]
        events = []
        for row in begun:
            level = Severity.ERROR if row.phase == Phase.ABORT else Severity.INFO
            why = f": {reason}" if reason and row is begun[-1] else ""
            text = f"{phase_name(row.phase)}{why}"
            events.append(Event((row.stamp_ns - origin_ns) * 1e-9, level, f"{name}.{CONTROLLER}", text))
        return events


def _wait_for(port: int) -> None:
    """Wait at most 2 s until the viewer accepts connections, so that it shows the start of the flight."""
    until_s = time.monotonic() + VIEWER_TIME_MAX_S
    while time.monotonic() < until_s:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=0.5):
            return
        time.sleep(0.02)


def _since(origin_ns: int, rows: Sequence[ControllerStepRow | LoopTimingRow]) -> Floats:
    return since(np.array([row.stamp_ns for row in rows], dtype=np.int64), origin_ns)


def _new(path: Path) -> Path:
    if path.suffix != ENDING:
        raise ValueError(f"--view {path}: {NATIVE}, {WEB} or a file that ends with {ENDING} is allowed")
    if path.exists():
        raise ValueError(f"--view: {path} exists and is not overwritten; choose another name")
    return path
