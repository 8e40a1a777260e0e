"""Runs the onboard process, aborts the flight outside the fence, and can interrupt the radio link."""

from __future__ import annotations

import contextlib
import math
import select
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from types import TracebackType

from bridge.zenoh import zenoh_link
from flightstack.common.processes import END_TIME_MAX_S, Child
from flightstack.core.types import Phase
from flightstack.watch import Watch
from tests.flight_suite.room import Room
from tests.processes.started import StartedChild

RADIO_POLL_S = 0.05


class Radio:
    """Context manager of a relay between companion and vehicle; the relay can drop all datagrams.

    ``url``: ``udpout:HOST:PORT`` of the vehicle; ``local_port``: UDP port on loopback to which the vehicle
    sends; 0: the vehicle replies to the sender.
    """

    def __init__(self, url: str, local_port: int = 0) -> None:
        _, host, port = url.split(":")
        self._vehicle = (host, int(port))
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.bind(("127.0.0.1", local_port))
        self.url = f"udpout:127.0.0.1:{self._near.getsockname()[1]}"  # vehicle URL for the onboard process
        self._companion: tuple[str, int] | None = None
        self._cut, self._end = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._forward, daemon=True)

    def cut(self) -> None:
        self._cut.set()

    def mend(self) -> None:
        self._cut.clear()

    def _forward(self) -> None:
        while not self._end.is_set():
            for ready in select.select([self._near, self._far], [], [], RADIO_POLL_S)[0]:
                data, sender = ready.recvfrom(65536)
                if self._cut.is_set():
                    continue
                if ready is self._near:
                    self._companion = sender
                    self._far.sendto(data, self._vehicle)
                elif self._companion is not None:
                    self._near.sendto(data, self._companion)

    def __enter__(self) -> Radio:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        self._thread.join()
        self._near.close()
        self._far.close()


POLL_S = 0.02
ABORT_MAX_S = 40.0  # time-out from an abort to its end, s


class Companion:
    """One flight of ``flightstack onboard``; ``watch`` receives the state that the process publishes."""

    def __init__(self, room: Room, child: Child, watch: Watch) -> None:
        self._room, self.child, self.watch = room, child, watch
        self.said: list[str] = []  # printed lines of the onboard process
        self._start: tuple[float, float, float] | None = None

    def until(self, word: str, limit_s: float) -> None:
        """Observe the flight until the process prints a line with this text.

        Raises AssertionError: the flight ended early, took too long, or left the fence and was aborted.
        """
        self._until(lambda: any(word in line for line in self.said), word, limit_s)

    def until_high(self, height_m: float, limit_s: float) -> None:
        """Observe the flight until the vehicle is this height above its first observed position.

        Raises AssertionError: as in ``until``.
        """
        self._until(lambda: self._height_m() > height_m, f"{height_m:g} m", limit_s)

    def _until(self, done: Callable[[], bool], what: str, limit_s: float) -> None:
        until_s = time.monotonic() + limit_s / self._room.speed
        while not done():
            alive = self.child.alive()
            self._look(POLL_S)
            if not alive and not done():
                raise AssertionError(f"ended before {what!r}: {self.said[-8:]} {self.child.errors()}")
            why = self._trouble()
            if time.monotonic() > until_s:
                why = f"no {what!r} within {limit_s:g} s"
            if why is not None:
                self._call_off()
                raise AssertionError(f"{why}; called off: {self.said[-8:]}")

    def _height_m(self) -> float:
        step = self.watch.step
        if step is None or self._start is None or not step.own_valid:
            return 0.0
        return step.own_position_enu_m[2] - self._start[2]

    def ended(self, limit_s: float) -> int:
        """Observe the flight until the process ends; return the exit status."""
        until_s = time.monotonic() + limit_s / self._room.speed
        while self.child.alive():
            self._look(POLL_S)
            why = self._trouble()
            if time.monotonic() > until_s:
                why = f"no end within {limit_s:g} s"
            if why is not None:
                self._call_off()
                raise AssertionError(f"{why}; called off: {self.said[-8:]}")
        self._look(0.0)
        return int(self.child.process.returncode)

    def signal(self, number: signal.Signals) -> None:
        self.child.process.send_signal(number)

    def kill(self) -> None:
        """Kill the process and wait for its end, because the next step opens the same sockets."""
        self.signal(signal.SIGKILL)
        self.child.process.wait(END_TIME_MAX_S)

    def _look(self, timeout_s: float) -> None:
        self.said += self.child.lines(timeout_s)
        self.watch.poll()

    def _trouble(self) -> str | None:
        step = self.watch.step
        if step is None or not self.watch.fresh or not step.own_valid:
            return None  # the state is unknown; the onboard process itself reacts to this
        if self._start is None:
            self._start = step.own_position_enu_m
        x, y, z = (a - b for a, b in zip(step.own_position_enu_m, self._start, strict=True))
        fence = self._room.fence
        if step.phase is not Phase.ABORT and (z > fence.height_m or math.hypot(x, y) > fence.distance_m):
            return f"{math.hypot(x, y):.2f} m away, {z:.2f} m high: beyond {fence}"
        return None

    def _call_off(self) -> None:
        """Request an abort; if the process does not end, kill it, so that the vehicle's own fail-safe lands
        the vehicle."""
        self.signal(signal.SIGINT)
        until_s = time.monotonic() + ABORT_MAX_S
        while self.child.alive() and time.monotonic() < until_s:
            self._look(POLL_S)
        self.child.end()


def onboard_words(room: Room) -> list[str]:
    """Return the command line of ``onboard`` with the options for a room."""
    words = ["onboard", "--vehicle", room.url, "--autopilot", room.autopilot, "--target", room.target_key]
    words += ["--target-offset", *map(str, room.target_offset_m), "--config", str(room.config)]
    words += ["--listen", room.listen, "--system-id", str(room.system_id), "--duration", "120"]
    words += ["--speed", str(room.speed)] if room.speed != 1.0 else []
    words += ["--clock", str(room.clock)] if room.clock is not None else []
    words += [word for endpoint in room.connect for word in ("--connect", endpoint)]
    if room.recorder is not None:
        words += ["--recorder", str(room.recorder)]
    elif room.target is not None:  # a real vehicle's flights are recorded
        words += ["--no-record"]
    return words + (["--signing-key", str(room.signing_key)] if room.signing_key else [])


@contextlib.contextmanager
def companion(room: Room) -> Iterator[Companion]:
    """Start the onboard process, and end it at the end of the context."""
    child = StartedChild("onboard", onboard_words(room), room.folder)
    session = None
    try:
        child.wait_ready()
        session = zenoh_link.open_session([], [room.listen])
        yield Companion(room, child, Watch(session, "cf1"))
    finally:
        child.end()
        if session is not None:
            session.close()
