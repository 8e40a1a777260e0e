"""Loopback ports for servers that start later; until then no other process can take them."""

from __future__ import annotations

from flightstack.common.processes import Port

_KEPT: list[Port] = []  # as long as this worker lives: a server may go, and come again


def free_port(*, udp: bool = False) -> int:
    """A port for a server of TCP, or of UDP."""
    _KEPT.append(Port(udp=udp))
    return _KEPT[-1].number


def free_endpoint() -> str:
    """One for a Zenoh session that listens."""
    return f"tcp/127.0.0.1:{free_port()}"
