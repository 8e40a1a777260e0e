"""The processes of one flight: started in order, watched with a live view, ended in order."""

from __future__ import annotations

import contextlib
import math
import shutil
import signal
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType

from rich.console import Console

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import on_hangup
from flightstack.common.processes import CLOSE_TIME_MAX_S, END_TIME_MAX_S, Child, Port, Running
from flightstack.core.mission.machine import parse
from flightstack.core.types import Phase
from flightstack.onboard.recording import start_recorder
from flightstack.watch.live import REFRESH_HZ, LiveView

NAMESPACE = "cf1"
LAND_ALONE_MAX_S = 20.0  # s of wall time for the vehicle's own landing without the onboard process
LAND_MAX_S = (
    30.0  # s for an onboard process that is asked to end in flight: it brings a real vehicle down first
)


@dataclass(frozen=True)
class Shown:
    """The data of the live view.

    Attributes:
        endpoint: Zenoh endpoint of the onboard process.
        title: of the view.
        namespace: first part of its keys.
    """

    endpoint: str
    title: str
    namespace: str = NAMESPACE


def words(**options: object) -> list[str]:
    """Return options as words of a command line.

    None and False are left out, True is a flag, a list repeats the option, a tuple holds the values of one.
    """
    found: list[str] = []
    for name, value in options.items():
        for each in value if isinstance(value, list) else [value]:
            if each is None or each is False:
                continue
            values = () if each is True else each if isinstance(each, tuple) else (each,)
            found += [f"--{name.replace('_', '-')}", *map(str, values)]
    return found


class Launcher:
    """Context manager that owns the child processes and ends all of them on exit.

    Attributes:
        children: running processes of this flight, in the order in which they were started.
        interrupted: whether the operator asked for the end of the run.
        last_line: the last that the onboard process said.
        aborted: whether the onboard process has given up and left the vehicle to its autopilot.
        socket: where the recorder listens.

    Args:
        folder: for what the children say.
        console: for the lines of the onboard process.
        tells: whether these are shown.
        real: a vehicle that is not ours to end: Ctrl-C, SIGTERM and a terminal that closes go to the onboard
            process, which lands it; the run ends with that process and not before.
    """

    def __init__(self, folder: Path, console: Console, *, tells: bool, real: bool = False) -> None:
        self.folder, self.console = folder, console
        self.children: list[Running] = []
        self.interrupted = False
        self.aborted = False
        self.last_line = ""
        self._tells, self._real = tells, real
        self._ports: list[Port] = []
        # a short path: socket names are limited to 107 bytes
        self._sockets = Path(tempfile.mkdtemp(prefix="flightstack-"))
        self.socket = self._sockets / "recorder"

    def __enter__(self) -> Launcher:
        end = self._hand_on if self._real else self._interrupt
        handlers = {signal.SIGINT: end, signal.SIGTERM: end, signal.SIGQUIT: self._hand_on}
        self._previous = {number: signal.signal(number, handler) for number, handler in handlers.items()}
        if self._real:
            on_hangup(self._hand_on)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        del kind, error, trace
        self.end_all()
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        shutil.rmtree(self._sockets, ignore_errors=True)

    def endpoint(self) -> str:
        """Return a Zenoh endpoint on loopback, on a port that is reserved for this flight.

        Raises:
            LaunchError: there is no free port.
        """
        port = Port()
        self._ports.append(port)
        return port.endpoint

    def start(self, verb: str, *arguments: str, **options: object) -> Child:
        """Start a verb of ``flightstack``; ``options`` are those of ``words``."""
        child = Child(verb, [verb, *arguments, *words(**options)], self.folder)
        self.children.append(child)
        return child

    def record(self, log: Path) -> Child:
        """Start the recorder and wait until it listens at ``socket``.

        Raises:
            LaunchError: it did not start.
        """
        recorder = start_recorder(self.socket, log)
        self.children.append(recorder)
        return recorder

    def view(self, where: str, endpoint: str, config: Path, namespace: str = NAMESPACE) -> None:
        """Start the view in 3-D and wait until it is ready. It only listens; the flight never waits for it.

        Args:
            where: of the option ``--view``.
            endpoint: Zenoh endpoint of the onboard process.
            config: file with the configuration of the onboard process.
            namespace: first part of its Zenoh keys.

        Raises:
            LaunchError: it did not start.
        """
        watch = self.start("watch", view=where, connect=endpoint, config=config, namespace=namespace)
        shown_at = watch.wait_ready()
        self.console.print(f"view: {shown_at}", style="dim", soft_wrap=True, markup=False)

    def end_all(self) -> None:
        """End every child; the recorder ends last, so that the log holds the end of the others."""
        for child in reversed(self.children):
            child.end(self._end_max_s(child.name))
        self.children.clear()
        for port in self._ports:
            port.close()

    def _end_max_s(self, name: str) -> float:
        if name == "record":
            return CLOSE_TIME_MAX_S
        return LAND_MAX_S if self._real and name == "onboard" else END_TIME_MAX_S

    def watch(
        self,
        onboard: Child,
        others: Sequence[Running],
        limit_s: float | None,
        shown: Shown | None,
        teller: Child | None = None,
    ) -> str | None:
        """Watch until the onboard process ends; return the problem, or None.

        Args:
            onboard: the onboard process.
            others: processes that have to outlive it.
            limit_s: wall time after which the run is given up; None: the onboard process knows its own.
            shown: for the live view; None: there is none.
            teller: process that says when the motors are armed and disarmed; None: nobody does.
        """
        others = list(others)
        until = time.monotonic() + (limit_s if limit_s is not None else math.inf)
        view = session = None
        problem: str | None = None
        if shown is not None:
            session = zenoh_link.open_session([], [shown.endpoint])
            view = LiveView(session, shown.namespace, shown.title, self.console)
            view.live.start()
        try:
            while onboard.alive():
                self._say(onboard.lines(1.0 / REFRESH_HZ))
                if view is not None:
                    view.poll()
                for child in [c for c in others if not c.alive()]:
                    # nobody else needs it to end safely: the onboard process holds, climbs or lands away
                    others.remove(child)
                    problem = f"{child.name} ended in flight: {child.errors() or 'no reason given'}"
                    self._print(problem, style="red")
                if self.interrupted:
                    return "interrupted"
                if limit_s is not None and time.monotonic() > until:
                    return f"not over after {limit_s:.0f} s"
            self._say(onboard.lines(0.0))
        finally:
            if view is not None:
                with contextlib.suppress(OSError):  # its terminal may be closed
                    view.live.stop()
            if session is not None:
                session.close()
        if onboard.process.returncode not in (0, 1):
            problem = f"onboard ended in flight: {onboard.errors() or 'no reason given'}"
            self.aborted = True
        if self.aborted:
            self._let_it_land(teller, until)
        return problem

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.interrupted = True

    def _hand_on(self, number: int, frame: FrameType | None) -> None:
        """Pass a signal on to the onboard process, which handles it according to its phase."""
        del frame
        for child in self.children:
            if isinstance(child, Child) and child.name == "onboard" and child.alive():
                child.process.send_signal(number)

    def _say(self, lines: list[str]) -> None:
        for line in lines:
            self.last_line = line
            change = parse(line)
            self.aborted = self.aborted or (change is not None and change.after is Phase.ABORT)
            if self._tells:
                self._print(line)

    def _print(self, text: str, style: str | None = None) -> None:
        with contextlib.suppress(OSError):  # a closed terminal must not end a flight
            self.console.print(text, style=style, highlight=False, markup=False)

    def _let_it_land(self, teller: Child | None, until: float) -> None:
        """Wait until the vehicle has landed by itself after the onboard process ended.

        What it has said so far has not been read: one that never armed, or stands already, is known at once.
        """
        until, armed = min(until, time.monotonic() + LAND_ALONE_MAX_S), False
        while teller is not None and teller.alive() and not self.interrupted and time.monotonic() < until:
            said = [line for line in teller.lines(0.2) if line in ("armed", "disarmed")]
            armed = said[-1] == "armed" if said else armed
            if not armed:
                return
