"""Processes of one flight: they are started in order, watched with a live view, and ended in order."""

from __future__ import annotations

import contextlib
import math
import shutil
import signal
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.live import Live

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import begun, handle
from flightstack.common.options import argv
from flightstack.common.pacing import COMPANION_SILENT_S
from flightstack.common.processes import CLOSE_TIME_MAX_S, END_TIME_MAX_S, Child, Port, socket_folder
from flightstack.common.terminal import Terminal
from flightstack.common.text import failed_code
from flightstack.config.options import WatchOptions
from flightstack.core.mission.machine import aborts
from flightstack.onboard.recording import end_recorder, start_recorder
from flightstack.watch import REFRESH_HZ, Watch, draw

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT, signal.SIGHUP)
# maximum wall time from the end of the onboard process to the end of the autopilot's landing, s
LAND_ALONE_MAX_S = COMPANION_SILENT_S + 100.0
RECORDER_YIELDS = 10  # nice value of the recorder, divided by the number of vehicles
LAND_MAX_S = 30.0  # maximum time for an onboard process to end, s: the process first lands a real vehicle


@dataclass
class Followed:
    """Onboard process that the launcher watches."""

    child: Child  # handle of the process
    namespace: str  # first part of the Zenoh keys of the process
    endpoints: Sequence[str]  # Zenoh endpoints of the process; the live view uses the first one
    last_line: str = ""  # newest line that the process printed
    aborted: bool = False  # whether the process aborted or failed, so that the autopilot lands the vehicle


def _verb(child: Child) -> str:
    """Return the command of a child: its name up to the hyphen before the vehicle's name, if there is one."""
    return child.name.partition("-")[0]


class Launcher(contextlib.ExitStack):
    """Context manager that owns the child processes and ends all of them on exit.

    ``tells``: whether the output of the onboard process is printed; ``real``: whether the vehicle is real.
    For a real vehicle, Ctrl-C, SIGTERM and a closed terminal are forwarded to the onboard process, which
    lands the vehicle; the run ends with this process.
    """

    def __init__(self, folder: Path, console: Terminal, *, tells: bool, real: bool = False) -> None:
        super().__init__()
        self.folder, self.console = folder, console  # folder for the output of the children
        # running processes of this flight, in the order in which they were started
        self.children: list[Child] = []
        self.interrupted = False  # whether the operator requested the end of the run
        self._tells, self._real = tells, real
        self._recorder: Child | None = None
        sockets = socket_folder()
        self.socket = sockets / "recorder"  # Unix socket on which the recorder listens
        # the exit runs these calls in reverse order; a second signal must not interrupt ``end_all``
        self.callback(shutil.rmtree, sockets, ignore_errors=True)
        for number in _SIGNALS:
            self.callback(signal.signal, number, signal.getsignal(number))
        self.callback(self.end_all)
        self.callback(self._take_over)

    def _take_over(self) -> None:
        """Install the launcher's signal handlers; before this call, signals have their previous effect."""
        for number in _SIGNALS:
            ends = number is not signal.SIGQUIT and not self._real
            handle({number: self._interrupt if ends else partial(self._hand_on, number)})

    def endpoint(self) -> str:
        """Return a Zenoh endpoint on loopback, on a port that is reserved for this flight."""
        return self.enter_context(contextlib.closing(Port())).endpoint

    def start(self, verb: str, options: object, of: str = "") -> Child:
        """Start a ``flightstack`` command; ``of``: name of the vehicle, if each vehicle has a process."""
        child = Child(f"{verb}-{of}" if of else verb, [verb, *argv(options)], self.folder)
        self.children.append(child)
        return child

    def hint(self, line: str, style: str | None = "dim") -> None:
        """Print a line for the operator; the default style is dim, because a hint is not an event."""
        self.console.print(line, style=style, soft_wrap=True)

    def record(self, log: Path) -> None:
        """Start the recorder and wait until it listens at ``socket``."""
        self._recorder = start_recorder(self.socket, log)
        self.children.append(self._recorder)

    def view(self, where: str, flights: Iterable[tuple[str, str, Path]]) -> None:
        """Start the 3-D view of onboard processes and wait until it is ready.

        ``where``: value of --view; ``flights``: namespace, endpoint and configuration of each process.
        """
        namespaces, endpoints, configs = zip(*flights, strict=True)
        options = WatchOptions(view=where, connect=endpoints, namespaces=namespaces, config_files=configs)
        self.hint(f"view: {self.start('watch', options).wait_ready()}")

    def end_all(self) -> None:
        """End every child; the recorder is last, so that the log contains the end of every other process."""
        most_s = {"record": CLOSE_TIME_MAX_S, "onboard": LAND_MAX_S if self._real else END_TIME_MAX_S}
        for child in reversed(self.children):
            child.end(most_s.get(_verb(child), END_TIME_MAX_S))
        self.children.clear()

    def fly(
        self, flights: Sequence[Followed], title: str | None, limit_s: float = math.inf,
        teller: Child | None = None, *, lockstep: bool = False,
    ) -> tuple[str | None, float]:  # fmt: skip
        """Watch the flights of the onboard processes, end all children; return problem and wall time, s.

        ``title``: title of the live view (None: no view); ``teller``: see ``Flying``.
        """
        for flight in flights:  # all processes load at the same time
            flight.child.wait_ready()
        if self._recorder is not None and not lockstep:  # a recorder without processor time loses records
            self._recorder.yield_to_others(RECORDER_YIELDS // len(flights))
        for flight in flights:
            for endpoint in flight.endpoints:
                self.hint(f"to watch: flightstack watch --connect {endpoint} --namespace {flight.namespace}")
        self._take_over()
        begun()
        started_s = time.monotonic()
        problem = self._watch(flights, title, limit_s, teller, lockstep=lockstep)
        wall_s = time.monotonic() - started_s
        self.end_all()
        if problem is None and self._recorder is not None:  # an end of the recorder is expected only now
            problem = end_recorder(self._recorder)
        return problem, wall_s

    def _watch(
        self, flights: Sequence[Followed], title: str | None, limit_s: float, teller: Child | None,
        *, lockstep: bool,
    ) -> str | None:  # fmt: skip
        """Watch until the onboard processes have ended; return an error text, or None."""
        others = [child for child in self.children if _verb(child) not in ("onboard", "watch")]
        flying, until, problem = list(flights), time.monotonic() + limit_s, None
        watches, endpoints, view = dict[str, Watch](), list[str](), None
        if title is not None:
            endpoints = [flight.endpoints[0] for flight in flights]
            session = zenoh_link.open_session([], endpoints)
            self.callback(session.close)
            watches = {flight.namespace: Watch(session, flight.namespace) for flight in flights}
            view = self.enter_context(Live(console=self.console, auto_refresh=False))
        while flying:
            for flight in flying:
                self._say(flight, flight.child.lines(1.0 / REFRESH_HZ if flight is flying[0] else 0.0))
            if view is not None:
                try:
                    for watch in watches.values():
                        watch.poll()
                    view.update(draw(watches, title or "", endpoints), refresh=True)
                except Exception as error:  # a failed view does not end the flight
                    view.stop()
                    view = None
                    self.hint(f"the live view has failed: {error!r}", style="red")
            for flight in [each for each in flying if not each.child.alive()]:
                flying.remove(flight)
                problem = self._ended(flight, others_fly=bool(flying)) or problem
            for child in [c for c in others if not c.alive()]:
                # if one of these processes ends, the onboard process holds, climbs or flies clear, and lands
                others.remove(child)
                if theirs := failed_code(child.errors()):
                    return theirs  # the simulator of the vehicle has ended
                problem = f"{child.name} ended in flight: {child.errors()}"
                self.hint(problem, style="red")
                if lockstep and _verb(child) == "world":  # end the flights: no further tick can arrive
                    self._hand_on(signal.SIGTERM)
            if self.interrupted:
                return "interrupted"
            if time.monotonic() > until:
                return f"not over after {limit_s:.0f} s"
        if view is not None:
            view.stop()
        if any(flight.aborted for flight in flights):
            self._let_it_land(teller, until)
        return problem

    def _ended(self, flight: Followed, *, others_fly: bool) -> str | None:
        """Print the last output of an onboard process that has ended; return an error text if it failed."""
        child = flight.child
        self._say(flight, child.lines(0.0))
        if child.process.returncode in (0, 1):
            if others_fly and child.process.returncode and not self._tells:
                self.hint(f"{flight.namespace}  {flight.last_line}", None)
            return None
        problem = f"{child.name} ended in flight: {child.errors()}"
        flight.aborted = True
        if others_fly:  # otherwise the result of the run has this text
            self.hint(problem, style="red")
        return problem

    def _interrupt(self) -> None:
        self.interrupted = True

    def _hand_on(self, number: int) -> None:
        """Forward a signal to the onboard processes; the effect depends on the phase of each flight."""
        for child in self.children:
            if isinstance(child, Child) and _verb(child) == "onboard" and child.alive():
                child.process.send_signal(number)

    def _say(self, flight: Followed, lines: list[str]) -> None:
        for line in lines:
            flight.last_line = line
            flight.aborted = flight.aborted or aborts(line)
            if self._tells:
                self.hint(f"{flight.namespace}  {line}", None)

    def _let_it_land(self, teller: Child | None, until: float) -> None:
        """Wait until the autopilots have landed the vehicles after the onboard processes have ended.

        The unread output of ``teller`` shows whether no vehicle has armed, or all have disarmed again.
        """
        until, armed = min(until, time.monotonic() + LAND_ALONE_MAX_S), set[str]()
        while teller is not None and teller.alive() and not self.interrupted and time.monotonic() < until:
            for line in teller.lines(0.2):
                change, _, vehicle = line.partition(" ")
                if change == "armed":
                    armed.add(vehicle)
                elif change == "disarmed":
                    armed.discard(vehicle)
            if not armed:
                return
