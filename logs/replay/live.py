"""Plays a log back onto the wires: the target's odometry on Zenoh, the vehicle's frames on UDP.

Payloads and frames go out as they were recorded, to the byte. Only what came from target and vehicle is
played, never what was sent to them: a replay commands no vehicle. ``Player`` keeps the time, with the keys of
a terminal; ``Wires`` opens the two sides; ``play`` brings both together.
"""

from __future__ import annotations

import itertools
import os
import secrets
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.profiles.autopilots import recorded_version
from bridge.mavlink.signing.key import load_key
from bridge.mavlink.transport.address import parse_udp_url
from bridge.target.odometry import ENCODING
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import GID_BYTES, pack_attachment
from logs.reader.reader import Message
from logs.replay.read import SOURCE, FlightInputs, ReplayError
from logs.schema.codec_mavlink import unpack_mavlink
from logs.schema.schemas import CONTROLLER_STEP, LOOP_TIMING

T = TypeVar("T")

SLICE_S = 0.05  # s of wall time between looks at keys and sockets
TOGGLE, STEP = " \r\n", "s"  # keys
_COMPONENT_ID = 1  # MAV_COMP_ID_AUTOPILOT1, whom the endpoint stands for
# Messages that are sent rarely and stay true until the next: played once before a start in the middle.
# HEARTBEAT, SYS_STATUS, HOME_POSITION, EXTENDED_SYS_STATE
_LASTING_IDS = frozenset({0, 1, 242, 245})
_VIEW = {"controller/step": CONTROLLER_STEP, "loop/timing": LOOP_TIMING}
Group = list[Message]


class Player:
    """Plays timed items at their distances in time.

    Attributes:
        paused: whether time stands still.
    """

    def __init__(
        self,
        rate: float,
        *,
        paused: bool = False,
        key: Callable[[float], str],
        idle: Callable[[], None],
        stopped: Callable[[], bool],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """Set up.

        Args:
            rate: seconds of the log in a second of wall time, > 0.
            paused: begin with time standing still.
            key: waits at most so many seconds and returns the key that was pressed, "" for none.
            idle: called at least every ``SLICE_S`` while waiting.
            stopped: whether to end.
            monotonic: the wall's clock.
        """
        self._rate, self._key, self._idle, self._stopped = rate, key, idle, stopped
        self._monotonic = monotonic
        self._at_s: float | None = None  # place in the log at wall time _since_s
        self._since_s = 0.0
        self._step = False
        self.paused = paused

    def play(self, items: Iterable[tuple[float, T]], send: Callable[[T], None]) -> int:
        """Send each item when its time has come; how many were sent.

        Args:
            items: (time in the log in s, item) in order.
            send: takes an item.
        """
        sent = 0
        self._at_s = None
        for at_s, item in items:
            if not self._wait(at_s):
                break
            send(item)
            sent += 1
        return sent

    def _wait(self, at_s: float) -> bool:
        """Wait for a place in the log; False when it is time to end."""
        if self._at_s is None:
            self._at_s, self._since_s = at_s, self._monotonic()
        while not self._stopped():
            wait_s = SLICE_S
            if self._step:
                self._step = False
                self._at_s, self._since_s = at_s, self._monotonic()
                return True
            if not self.paused:
                wait_s = (at_s - self._place()) / self._rate
                if wait_s <= 0.0:
                    return True
            self._idle()
            self._pressed(self._key(min(wait_s, SLICE_S)))
        return False

    def _place(self) -> float:
        assert self._at_s is not None
        return self._at_s + (self._monotonic() - self._since_s) * self._rate

    def _pressed(self, key: str) -> None:
        if key and key in TOGGLE:
            if not self.paused:
                self._at_s = self._place()
            self._since_s = self._monotonic()
            self.paused = not self.paused
        elif key == STEP and self.paused:
            self._step = True


def no_keys(timeout_s: float) -> str:
    """Wait without a keyboard; no key is ever pressed."""
    time.sleep(timeout_s)
    return ""


class Terminal:
    """Single keys of the terminal, without waiting for the end of a line."""

    def __init__(self) -> None:
        self._before: list[Any] = []

    def __enter__(self) -> Terminal:
        """Switch the terminal over."""
        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give it back as it was."""
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def key(self, timeout_s: float) -> str:
        """Wait at most so long for a key."""
        if not select.select([sys.stdin], [], [], timeout_s)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 1).decode(errors="replace")  # unbuffered: select must see the rest


@dataclass(frozen=True)
class LiveOptions:
    """Where and how a log is played."""

    vehicle_url: str | None = None
    target_key: str | None = None  # None: as recorded
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    view: bool = False  # publish the recorded steps and timing, too, for viewers
    rate: float = 1.0
    start_s: float = 0.0
    loop: bool = False
    pause: bool = False
    wait_s: float = 10.0
    duration_s: float | None = None
    signing_key: Path | None = None
    allow_unsigned: bool = False
    member: str | None = None  # of a fleet


class Wires:
    """The two sides that are played."""

    def __init__(self, flight: FlightInputs, options: LiveOptions, stack: ExitStack) -> None:
        """Open what the options name; ``stack`` closes it.

        Raises:
            ValueError: a URL, endpoint or key that is not understood.
            OSError: an address or file that cannot be opened.
        """
        self._endpoint: Endpoint | None = None
        self._publishers: dict[str, zenoh_link.Publisher] = {}
        self._gid = secrets.token_bytes(GID_BYTES)
        self._calls = False
        if options.vehicle_url is not None:
            parse_udp_url(options.vehicle_url, "a replayed vehicle")
            key = load_key(options.signing_key) if options.signing_key else None
            system_id = int(flight.onboard.get("system_id", "1"))
            self._endpoint = Endpoint(
                options.vehicle_url, system_id, _COMPONENT_ID, signing_key=key,
                allow_unsigned=options.allow_unsigned,
            )  # fmt: skip
            stack.callback(self._endpoint.close)
            self._calls = options.vehicle_url.startswith("udpout")
        if options.connect or options.listen:
            session = zenoh_link.open_session(options.listen, options.connect)
            stack.callback(session.close)
            odometry = flight.topic("target/odom")
            key_expr = options.target_key or flight.onboard.get("target_key", odometry.lstrip("/"))
            self._publishers[odometry] = zenoh_link.dropping_publisher(session, key_expr, ENCODING)
            for name, schema in _VIEW.items() if options.view else ():
                topic = flight.topic(name)
                self._publishers[topic] = zenoh_link.dropping_publisher(
                    session, topic.lstrip("/"), f"application/cdr;{schema}"
                )
        self.topics = {*self._publishers, *([SOURCE] if self._endpoint else [])}

    @property
    def local_url(self) -> str:
        """Where the vehicle can be reached; empty without one."""
        return f"udpin:127.0.0.1:{self._endpoint.local_port}" if self._endpoint and not self._calls else ""

    def missing(self) -> str:
        """Who is not there yet, in words; empty when everybody is."""
        self.idle()
        found = []
        if self._endpoint and not self._calls and not self._endpoint.peers:
            found.append("nobody has called the vehicle's MAVLink address")
        if self._publishers and not any(map(zenoh_link.is_matched, self._publishers.values())):
            found.append("nobody subscribes to the target's key on Zenoh")
        return " and ".join(found)

    def idle(self) -> None:
        """Receive frames to learn their senders; answer requests for the version as a recording."""
        if self._endpoint is None:
            return
        for received in self._endpoint.receive():
            asked = received.message
            if (
                asked.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_LONG
                and asked.command == dialect.MAV_CMD_REQUEST_MESSAGE
                and asked.param1 == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
            ):
                self._endpoint.send([recorded_version()], received.peer)

    def send(self, group: Group) -> None:
        """Send the messages of one tick."""
        self.idle()
        for message in group:
            if message.topic == SOURCE:
                assert self._endpoint is not None
                self._endpoint.repeat(unpack_mavlink(message.data)[1])
            else:
                attachment = None
                if message.sequence:
                    attachment = pack_attachment(message.sequence, message.publish_time_ns, self._gid)
                self._publishers[message.topic].put(message.data, attachment=attachment)


def groups(flight: FlightInputs, topics: set[str], start_s: float) -> Iterator[tuple[float, Group]]:
    """Yield (seconds since the first message, messages of that time).

    Args:
        flight: the log.
        topics: those to play.
        start_s: what comes before is left out, but for the newest of each lasting message.
    """
    lasting: dict[bytes, Message] = {}
    first_ns: int | None = None
    for log_ns, members in itertools.groupby(flight.log.messages(topics), key=lambda m: m.log_time_ns):
        first_ns = log_ns if first_ns is None else first_ns
        at_s, group = (log_ns - first_ns) / 1e9, list(members)
        if at_s < start_s:
            lasting.update(_lasting(group))
            continue
        if lasting:
            yield at_s, list(lasting.values())
            lasting = {}
        yield at_s, group


def _lasting(group: Group) -> Iterator[tuple[bytes, Message]]:
    for message in group:
        if message.topic == SOURCE:
            frame = unpack_mavlink(message.data)[1]
            if frame[0] == 0xFD and int.from_bytes(frame[7:10], "little") in _LASTING_IDS:
                yield frame[5:10], message  # sender and message id


def play(path: Path | str, options: LiveOptions, say: Callable[[str], None] = print) -> int:
    """Play a log; how many ticks went out.

    Raises:
        ReplayError: nothing to play, or no listener.
        ValueError: an option that is not understood.
        OSError: an address that cannot be opened.
    """
    if options.vehicle_url is None and not (options.connect or options.listen):
        raise ReplayError("--live: give --vehicle-url, or --listen or --connect for Zenoh, or both")
    if options.view and (options.vehicle_url is not None or not (options.connect or options.listen)):
        raise ReplayError("--view needs --listen or --connect, and no --vehicle-url: what flies shows itself")
    if options.pause and not sys.stdin.isatty():
        raise ReplayError("--pause: standard input is no terminal, so nobody could go on")
    flight = FlightInputs(path, options.member)
    with ExitStack() as stack:
        stop = _Stop(stack)
        wires = Wires(flight, options, stack)
        key = stack.enter_context(Terminal()).key if sys.stdin.isatty() else no_keys
        say(f"ready {wires.local_url}".rstrip())
        sys.stdout.flush()
        _wait_for_listeners(wires, options.wait_s, stop)
        until_s = time.monotonic() + options.duration_s if options.duration_s else float("inf")

        def stopped() -> bool:
            return stop.asked or time.monotonic() >= until_s

        player = Player(options.rate, paused=options.pause, key=key, idle=wires.idle, stopped=stopped)
        ticks = 0
        while True:
            sent = player.play(groups(flight, wires.topics, options.start_s), wires.send)
            ticks += sent
            if not sent and not stopped():
                raise ReplayError(f"{path}: nothing to play of {', '.join(sorted(wires.topics))} there")
            if not options.loop or stopped():
                return ticks


class _Stop:
    """Ctrl-C or SIGTERM ends the replay in order."""

    def __init__(self, stack: ExitStack) -> None:
        self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            stack.callback(signal.signal, number, signal.signal(number, self._ask))

    def _ask(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.asked = True


def _wait_for_listeners(wires: Wires, wait_s: float, stop: _Stop) -> None:
    until_s = time.monotonic() + wait_s
    while (missing := wires.missing()) and wait_s > 0.0 and not stop.asked:
        if time.monotonic() >= until_s:
            raise ReplayError(f"--live: {missing} within {wait_s:g} s; --wait 0 plays to nobody")
        time.sleep(SLICE_S)
