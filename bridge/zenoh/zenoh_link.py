"""Zenoh sessions that connect only to the given endpoints and that the owner's loop polls.

Scouting and gossip are off unless a configuration file enables them. There are no callbacks: a callback runs
in another thread, hides exceptions, and blocks the end of a process with an open session. Zenoh retries a
connection silently, so ``ConnectionAlarm`` monitors the connection; a rejected certificate, a wrong password
and a missing machine cannot be distinguished.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import zenoh

from flightstack.common.pacing import ask_for_priority, give_up_priority
from flightstack.common.strict_toml import decoded

Session = Any  # ``Any``, so that mypy does not need the zenoh package
Publisher = Any
Subscriber = Any
Sample = Any

LOOPBACK = "tcp/127.0.0.1:0"  # endpoint on any free port; only this machine can connect
LOOPBACK_ROUTER = "tcp/127.0.0.1:7447"  # default address of a router for clients and ROS 2 nodes
_LEASE_MS = 2000  # time without messages after which a peer is disconnected and connected again, ms
# the same time in lockstep, ms: a pause must lose no message; a killed process disconnects immediately anyway
_LOCKSTEP_WAIT_MS = 60_000
_ALIVE_TIMEOUT_S = 1.0  # time-out of a liveliness query, s; this process answers the query from its tables
_CLIENT_WAIT_MS = 10_000  # maximum wait for a router that has not started, ms
_RETRY = {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5}


class Role(Enum):
    """Role of a session (``mode`` of a Zenoh configuration)."""

    PEER = "peer"  # process that exchanges data with direct connections only
    CLIENT = "client"  # process that exchanges data with all clients and peers of a router
    ROUTER = "router"  # process that forwards data, except between two of its peers


_DEFAULTS: dict[str, Any] = {
    "connect/retry": _RETRY,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,  # 0 avoids that open() blocks for 500 ms without a peer
    "transport/link/tx/lease": _LEASE_MS,
    # shared memory needs /dev/shm and has no benefit for this stack's small messages
    "transport/shared_memory/enabled": False,
}
_ROLE_DEFAULTS: dict[Role, dict[str, Any]] = {
    Role.PEER: {"listen/endpoints": [LOOPBACK]},  # Zenoh's default is every interface
    Role.CLIENT: {"listen/endpoints": [], "connect/timeout_ms": _CLIENT_WAIT_MS},
    # ROS 2 nodes discover each other by gossip scouting at their router (rmw_zenoh's default router).
    Role.ROUTER: {"listen/endpoints": [LOOPBACK_ROUTER], "scouting/gossip/enabled": True},
}
_LOCKSTEP: dict[str, Any] = {
    "transport/link/tx/lease": _LOCKSTEP_WAIT_MS,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1000 * _LOCKSTEP_WAIT_MS,  # in us
}
_IP = re.compile(r"^(tcp|udp|tls|quic|ws)/(?:\[[0-9a-fA-F:.%]+\]|[^\s/:\[\]]+):(\d{1,5})$")
_THIS_MACHINE = re.compile(r"^(unixsock-stream/|\w+/(127\.\d+\.\d+\.\d+|localhost|\[::1\]):)")
_UNIX = re.compile(r"^unixsock-stream/\S+$")
_HELP = (
    "allowed is PROTOCOL/HOST:PORT with protocol tcp, udp, tls, quic or ws and port up to 65535, for example "
    "tcp/127.0.0.1:7447, or unixsock-stream/PATH"
)


class ZenohLinkError(OSError):
    """A session that could not be opened, with endpoint and reason."""


def check_endpoint(endpoint: str) -> str:
    """Check an endpoint, since Zenoh silently retries malformed endpoints. Raises ValueError: malformed."""
    match = _IP.match(endpoint.partition("?")[0].partition("#")[0])
    if (match and int(match.group(2)) <= 65535) or _UNIX.match(endpoint):
        return endpoint
    raise ValueError(f"Zenoh endpoint {endpoint!r} is not understood: {_HELP}")


def open_session(
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    *,
    config_file: Path | None = None,
    role: Role = Role.PEER,
    prompt: bool = False,
    lockstep: bool = False,
) -> Session:
    """Open a session with these endpoints and no others.

    A configuration file provides the settings; endpoints given here replace those of the file. A peer, the
    default, returns immediately even without a connection, and retries in the background every 0.05 to 0.5 s.
    A client needs its router within 10 s, and continues after a loss. A rejected connection is not reported;
    see ``transports`` and the age of messages. Close the session after use.

    Args:
        listen: endpoints for incoming connections; empty: those of the file, or a free port on loopback.
        connect: endpoints to connect to; empty: those of the file.
        config_file: a Zenoh configuration (JSON5), for example with TLS keys and access rules.
        role: used if the file does not set the mode; a router does not forward between its peers.
        prompt: request real-time priority for the threads of the session, if the system allows it.
        lockstep: a connection survives a pause of 60 s of a process at either end without losing messages.

    Raises:
        ValueError: an endpoint or the file is malformed.
        ZenohLinkError: the session could not be opened, for example because a port is taken.
    """
    listen = [check_endpoint(endpoint) for endpoint in listen]
    connect = [check_endpoint(endpoint) for endpoint in connect]
    config = _configuration(listen, connect, config_file, role)
    if lockstep:
        for key, value in _LOCKSTEP.items():
            config.insert_json5(key, json.dumps(value))
    prompt = prompt and ask_for_priority()  # threads that start now inherit the priority
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        hint = "is the port taken"
        if _role(config) is Role.CLIENT:
            hint = "is the router running, and does it accept us"
        at, to = (", ".join(_endpoints(config, kind)) or "nothing" for kind in ("listen", "connect"))
        raise ZenohLinkError(
            f"cannot open a Zenoh session that listens on {at} and connects to {to}: {_reason(error)}; "
            f"{hint}?"
        ) from error
    finally:
        if prompt:
            give_up_priority()


def _configuration(listen: Sequence[str], connect: Sequence[str], file: Path | None, role: Role) -> Any:
    """Return Zenoh's configuration.

    Arguments override the file, and the file overrides this module's defaults.
    """
    untouched = zenoh.Config()
    try:
        if file is None:
            config = zenoh.Config()
        elif file.suffix in (".json", ".json5"):
            config = zenoh.Config.from_json5(decoded(file.read_bytes()))
        else:
            config = zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        raise ValueError(f"Zenoh configuration {file}: {_reason(error)}") from error
    except (ValueError, OSError) as error:
        raise ValueError(f"Zenoh configuration {file}: {error}") from error

    def fill(key: str, value: Any) -> None:
        if config.get_json(key) == untouched.get_json(key):
            config.insert_json5(key, json.dumps(value))

    fill("mode", role.value)
    role = _role(config)
    if listen and role is Role.CLIENT:
        raise ValueError(
            f"a client of a Zenoh router cannot listen, here on {', '.join(listen)}: leave one out"
        )
    for key, endpoints in {"listen/endpoints": listen, "connect/endpoints": connect}.items():
        if endpoints:
            config.insert_json5(key, json.dumps(list(endpoints)))
    for key, value in {**_DEFAULTS, **_ROLE_DEFAULTS[role]}.items():
        fill(key, value)
    return config


def _role(config: Any) -> Role:
    return Role(json.loads(config.get_json("mode")))


def _endpoints(config: Any, kind: str) -> list[str]:
    endpoints = json.loads(config.get_json(f"{kind}/endpoints"))
    if isinstance(endpoints, dict):
        endpoints = endpoints.get(_role(config).value, [])
    return [str(one) for one in endpoints]


def _reason(error: zenoh.ZError) -> str:
    return str(error).partition(" at /")[0]  # the text after " at /" is a source path


def blocking_publisher(session: Session, key: str, encoding: str | None = None) -> Publisher:
    """Declare a publisher that waits for room, at most 5 s, in lockstep 60 s; then Zenoh disconnects."""
    return _publisher(session, key, encoding, zenoh.CongestionControl.BLOCK)


def dropping_publisher(session: Session, key: str, encoding: str | None = None) -> Publisher:
    """Declare a publisher that drops samples when its queue is full (real time)."""
    return _publisher(session, key, encoding, zenoh.CongestionControl.DROP)


def ring_subscriber(session: Session, key: str, capacity: int = 256) -> Subscriber:
    """Declare a subscriber that stores the newest ``capacity`` samples and drops older ones (real time)."""
    return session.declare_subscriber(_key(key), zenoh.handlers.RingChannel(capacity))


def remote_subscriber(session: Session, key: str, capacity: int = 256) -> Subscriber:
    """Declare a ring subscriber that ignores the publications of its own session."""
    return session.declare_subscriber(
        _key(key), zenoh.handlers.RingChannel(capacity), allowed_origin=zenoh.Locality.REMOTE
    )


def fifo_subscriber(session: Session, key: str, capacity: int = 1024) -> Subscriber:
    """Declare a subscriber without losses: a full subscriber blocks the sender (lockstep)."""
    return session.declare_subscriber(_key(key), zenoh.handlers.FifoChannel(capacity))


def liveliness_token(session: Session, key: str) -> Any:
    """Declare a token, visible to connected sessions until this session ends. Raises ValueError: bad key."""
    return session.liveliness().declare_token(_key(key))


def is_alive(session: Session, key: str) -> bool:
    return any(True for _ in session.liveliness().get(_key(key), timeout=_ALIVE_TIMEOUT_S))


def drain(subscriber: Subscriber) -> list[Sample]:
    """Return all samples that have arrived, oldest first; never blocks."""
    samples: list[Sample] = []
    while (sample := subscriber.try_recv()) is not None:
        samples.append(sample)
    return samples


def is_matched(publisher: Publisher) -> bool:
    """Whether there is a subscriber; samples sent without a subscriber are lost."""
    return bool(publisher.matching_status.matching)  # the status object itself is always true


def transports(session: Session) -> int:
    """Return the number of connections; always 0: the peer is unreachable or rejects this session."""
    return len(session.info.transports())


def dialled(
    connect: Sequence[str] = (), *, config_file: Path | None = None, role: Role = Role.PEER
) -> tuple[Role, list[str]]:
    """Return the role of ``open_session`` with these arguments, and the endpoints to which it connects."""
    config = _configuration((), connect, config_file, role)
    return _role(config), _endpoints(config, "connect")


def open_to_all(listen: Sequence[str] = (), *, config_file: Path | None = None) -> list[str]:
    """Return the endpoints on which ``open_session`` listens to a network, if there are no access rules."""
    config = _configuration(listen, (), config_file, Role.PEER)
    if json.loads(config.get_json("access_control/enabled")):
        return []
    return [one for one in _endpoints(config, "listen") if not _THIS_MACHINE.match(one)]


def knows_router(session: Session) -> bool:
    """Whether one of the connections leads to a router."""
    return any(True for _ in session.info.routers_zid())


def _publisher(session: Session, key: str, encoding: str | None, congestion: Any) -> Publisher:
    return session.declare_publisher(
        _key(key), encoding=zenoh.Encoding(encoding) if encoding else None, congestion_control=congestion
    )


def _key(key: str) -> Any:
    try:
        return zenoh.KeyExpr(key)
    except zenoh.ZError as error:
        raise ValueError(
            f"Zenoh key {key!r} is not allowed ({_reason(error)}): chunks parted by single "
            "slashes, no slash at the ends, no '#', '?' or '$', for example cf1/target/odom"
        ) from error


PATIENCE_S = 3.0  # time without a connection before a warning, s; a restarted router is back sooner
LOOK_EVERY_S = 1.0


class ConnectionAlarm:
    """Monitors the connection of a session to the endpoints ``whom``, if any; call ``poll`` in every tick."""

    def __init__(self, session: Session, whom: Sequence[str], role: Role = Role.PEER) -> None:
        self._session, self._whom = session, ", ".join(whom)
        self._since_s: float | None = None  # start of the time without a connection, s
        self._next_s = -1.0
        self._said = False
        self._said_router = role is not Role.PEER

    def poll(self, now_s: float) -> list[str]:
        """Return texts about changes since the last call; ``now_s`` must never go back."""
        if not self._whom or now_s < self._next_s:
            return []
        self._next_s = now_s + LOOK_EVERY_S
        if transports(self._session) == 0:
            self._since_s = now_s if self._since_s is None else self._since_s
            if self._said or now_s - self._since_s < PATIENCE_S:
                return []
            self._said = True
            return [
                f"Zenoh: no connection to {self._whom} for {now_s - self._since_s:.0f} s: no reply, or it "
                "rejects our certificate or password"
            ]
        texts: list[str] = []
        if self._said and self._since_s is not None:
            texts.append(f"Zenoh: connected to {self._whom} after {now_s - self._since_s:.0f} s")
        self._since_s, self._said = None, False
        if not self._said_router and knows_router(self._session):
            self._said_router = True
            texts.append(
                f"Zenoh: {self._whom} is a router, and we are its peer: it does not forward from its other "
                "peers, such as ROS 2 nodes; use mode client in --zenoh-config "
                "(docs/how_to/zenoh.md)"
            )
        return texts


GID_BYTES = 16
_ATTACHMENT = struct.Struct("<qqB16s")  # "B" is the length of the id (attachment_helpers.cpp)


def pack_attachment(sequence: int, source_time_ns: int, gid: bytes) -> bytes:
    """Return the 33-byte attachment: sequence from 1, Unix time of sending, publisher id."""
    return _ATTACHMENT.pack(sequence, source_time_ns, GID_BYTES, gid)


def parse_attachment(data: bytes | None) -> tuple[int, int] | None:
    """Return sequence number and source time (Unix, ns); None: no attachment, or malformed."""
    if data is None or len(data) != _ATTACHMENT.size:
        return None
    sequence, source_time_ns, length, _ = _ATTACHMENT.unpack(data)
    return (sequence, source_time_ns) if length == GID_BYTES else None
