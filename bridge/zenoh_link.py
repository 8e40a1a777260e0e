"""Zenoh sessions that talk to whom they were told and nobody else, polled from the owner's loop.

No scouting, no gossip, no callbacks: a callback runs in another thread, swallows exceptions, and keeps the
process from ending when the session is not closed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

import zenoh

Session = Any  # the zenoh package's own types are not relied on
Publisher = Any
Subscriber = Any
Sample = Any

LOOPBACK = "tcp/127.0.0.1:0"  # any free port, this machine only
_LEASE_MS = 2000  # a peer silent this long is dropped and dialled again; liveness is judged by message age
_RETRY = {"period_init_ms": 50, "period_max_ms": 500, "period_increase_factor": 1.5}
_IP = re.compile(r"^(tcp|udp|tls|quic|ws)/(?:\[[0-9a-fA-F:.%]+\]|[^\s/:\[\]]+):(\d{1,5})$")
_UNIX = re.compile(r"^unixsock-stream/\S+$")
_HELP = (
    "allowed is PROTOCOL/HOST:PORT with protocol tcp, udp, tls, quic or ws and port up to 65535, for example "
    "tcp/127.0.0.1:7447, or unixsock-stream/PATH"
)


class ZenohLinkError(RuntimeError):
    """A session that could not be opened; the text says which endpoint and why."""


def check_endpoint(endpoint: str) -> str:
    """Return the endpoint if it is well formed.

    Zenoh itself takes a malformed endpoint to connect to without a word and retries for ever.

    Raises:
        ValueError: it is not; the text says what is allowed.
    """
    match = _IP.match(endpoint.partition("?")[0].partition("#")[0])
    if (match and int(match.group(2)) <= 65535) or _UNIX.match(endpoint):
        return endpoint
    raise ValueError(f"Zenoh endpoint {endpoint!r} is not understood: {_HELP}")


def open_session(
    listen: Sequence[str] = (), connect: Sequence[str] = (), *, config_file: str | None = None
) -> Session:
    """Open a peer session with these endpoints and no others.

    Returns at once even if nobody answers on ``connect``: that is retried in the background every 0.05 to
    0.5 s. A refused connection is as silent; look at ``transports`` and at message ages. Close it when done.

    Args:
        listen: where others may connect; empty means a free port on loopback.
        connect: whom to connect to.
        config_file: a Zenoh configuration to start from, for example with TLS keys and access rules.

    Raises:
        ValueError: an endpoint is malformed.
        ZenohLinkError: the session could not be opened, for example because a port is taken.
    """
    listen = [check_endpoint(endpoint) for endpoint in listen] or [LOOPBACK]
    connect = [check_endpoint(endpoint) for endpoint in connect]
    settings: dict[str, Any] = {
        "mode": "peer",
        "listen/endpoints": listen,  # Zenoh's own default is every interface
        "connect/endpoints": connect,
        "connect/retry": _RETRY,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # else open() stalls 500 ms when a peer is not there yet
        "transport/link/tx/lease": _LEASE_MS,
    }
    try:
        config = zenoh.Config.from_file(config_file) if config_file else zenoh.Config()
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        reason = str(error).partition(" at /")[0]  # the rest is a path in the build machine's source tree
        raise ZenohLinkError(
            f"cannot open a Zenoh session that listens on {', '.join(listen)} and connects to "
            f"{', '.join(connect) or 'nobody'}: {reason}; is the port taken by another process?"
        ) from error


def blocking_publisher(session: Session, key: str, encoding: str | None = None) -> Publisher:
    """Declare a publisher whose ``put`` waits for room (lockstep); after 5 s Zenoh drops the connection."""
    return _publisher(session, key, encoding, zenoh.CongestionControl.BLOCK)


def dropping_publisher(session: Session, key: str, encoding: str | None = None) -> Publisher:
    """Declare a publisher whose ``put`` drops the sample when there is no room (real time)."""
    return _publisher(session, key, encoding, zenoh.CongestionControl.DROP)


def ring_subscriber(session: Session, key: str, capacity: int = 256) -> Subscriber:
    """Declare a subscriber that keeps the newest ``capacity`` samples and drops older ones (real time)."""
    return session.declare_subscriber(_key(key), zenoh.handlers.RingChannel(capacity))


def fifo_subscriber(session: Session, key: str, capacity: int = 1024) -> Subscriber:
    """Declare a subscriber that loses nothing: when full it holds up the connection (lockstep)."""
    return session.declare_subscriber(_key(key), zenoh.handlers.FifoChannel(capacity))


def drain(subscriber: Subscriber) -> list[Sample]:
    """Take all samples that have arrived, oldest first; never blocks."""
    samples: list[Sample] = []
    while (sample := subscriber.try_recv()) is not None:
        samples.append(sample)
    return samples


def is_matched(publisher: Publisher) -> bool:
    """Tell whether a subscriber is known; what is put before that is lost."""
    return bool(publisher.matching_status.matching)  # the status object itself is always true


def transports(session: Session) -> int:
    """Number of open connections to other sessions; 0 long after opening means refused or not there."""
    return len(session.info.transports())


def _publisher(session: Session, key: str, encoding: str | None, congestion: Any) -> Publisher:
    return session.declare_publisher(
        _key(key),
        encoding=zenoh.Encoding(encoding) if encoding else None,
        congestion_control=congestion,
    )


def _key(key: str) -> Any:
    try:
        return zenoh.KeyExpr(key)
    except zenoh.ZError as error:
        raise ValueError(
            f"Zenoh key {key!r} is not allowed ({str(error).partition(' at /')[0]}): chunks parted by single "
            "slashes, no slash at the ends, no '#', '?' or '$', for example cf1/target/odom"
        ) from error
