"""Plays a log back onto the wires: the target's odometry on Zenoh, the vehicle's frames on UDP.

Payloads and frames go out as they were recorded, to the byte. Only what came from target and vehicle is
played, never what was sent to them: a replay commands no vehicle.
"""

from __future__ import annotations

import itertools
import secrets
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.profiles.autopilot_version import recorded_version
from bridge.mavlink.signing.key import load_key
from bridge.mavlink.transport.address import parse_udp_url
from bridge.target.odometry import ENCODING
from bridge.zenoh import zenoh_link
from bridge.zenoh.attachment import GID_BYTES, pack_attachment
from logs.reader.reader import Message
from logs.replay.player import SLICE_S, Player, Terminal, no_keys
from logs.replay.read import SOURCE, FlightInputs, ReplayError
from logs.schema.codec_mavlink import unpack_mavlink
from logs.schema.schemas import CONTROLLER_STEP, LOOP_TIMING

_COMPONENT_ID = 1  # MAV_COMP_ID_AUTOPILOT1, whom the endpoint stands for
# Messages that are sent rarely and stay true until the next: played once before a start in the middle.
# HEARTBEAT, SYS_STATUS, HOME_POSITION, EXTENDED_SYS_STATE
_LASTING_IDS = frozenset({0, 1, 242, 245})
_VIEW = {"controller/step": CONTROLLER_STEP, "loop/timing": LOOP_TIMING}
Group = list[Message]


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
    flight = FlightInputs(path)
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

        player = Player(
            options.rate,
            paused=options.pause,
            key=key,
            idle=wires.idle,
            stopped=stopped,
        )
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
