"""Loopback ports for servers that start later; no other process can take them until then."""

from __future__ import annotations

from flightstack.common.processes import Port

_KEPT: list[Port] = []  # kept until this worker ends, because a server may restart


def free_port(*, udp: bool = False) -> int:
    """Return a port for a TCP or UDP server."""
    _KEPT.append(Port(udp=udp))
    return _KEPT[-1].number


def free_endpoint() -> str:
    """Return a port for a Zenoh session that listens."""
    return f"tcp/127.0.0.1:{free_port()}"
