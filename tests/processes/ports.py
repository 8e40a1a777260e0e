"""Reserves loopback ports for servers that start later; until then no other process can use these ports."""

from __future__ import annotations

import socket

from flightstack.common.processes import Port

_KEPT: list[Port | socket.socket] = []  # reserved until this worker ends, because a server may restart


def free_port(*, udp: bool = False) -> int:
    port = Port()
    _KEPT.append(port)
    if udp:  # the UDP port is freed for the server; a TCP port with the same number is reserved instead
        _KEPT[-1] = socket.create_server(("127.0.0.1", port.number))
        port.close()
    return port.number


def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"
