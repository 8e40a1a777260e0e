"""TCP connection to one PX4, over which the simulator exchanges MAVLink messages with it."""

from __future__ import annotations

import contextlib
import select
import socket
from collections.abc import Iterable, Sequence
from ipaddress import IPv4Address

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.transport.address import parse_peer
from sim.px4.plant import COMPONENT_ID, SYSTEM_ID

_CHUNK = 65536  # maximum bytes per read
_SEND_MAX_S = 5.0  # maximum time for which PX4's receive buffer may be full, s
_BAD_DATA: int = dialect.MAVLINK_MSG_ID_BAD_DATA  # undecodable bytes; unknown messages also have negative ids
SLICE_S = 0.1  # maximum wait for the socket, s


class LinkClosedError(ConnectionError):
    """The connection has ended, with the cause as text: PX4 closed it, or the client is not PX4."""


def parse_endpoint(text: str, *, allow_unsigned: bool) -> tuple[str, int]:
    """Return address and port of ``HOST:PORT``."""
    host, port = parse_peer(text, "TCP endpoint", port_min=0)
    if not IPv4Address(host).is_loopback and not allow_unsigned:
        raise ValueError(
            f"TCP endpoint {text!r} is open to a network, and PX4's simulator link knows no signatures: "
            "listen on 127.0.0.1, or say --allow-unsigned"
        )
    return host, port


class Px4Link:
    """A connection that PX4 has opened."""

    def __init__(self, connected: socket.socket) -> None:
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connected.settimeout(_SEND_MAX_S)
        self._socket = connected
        # pymavlink's parser suffices: TCP loses and damages no bytes, and PX4 is the only sender
        self._mav = dialect.MAVLink(None, srcSystem=SYSTEM_ID, srcComponent=COMPONENT_ID)
        self._mav.robust_parsing = True
        self.garbage_bytes = 0  # number of bytes outside of any frame

    def send(self, messages: Iterable[Message]) -> None:
        """Send all messages in one write."""
        data = b""
        for message in messages:
            data += message.pack(self._mav)
            self._mav.seq = (self._mav.seq + 1) % 256
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkClosedError(f"sending to PX4 failed: {error}") from error

    def receive(self, timeout_s: float) -> Sequence[Message]:
        """Return the messages received within ``timeout_s``, at most ``SLICE_S``."""
        if not select.select([self._socket], [], [], max(0.0, min(timeout_s, SLICE_S)))[0]:
            return ()
        try:
            data = self._socket.recv(_CHUNK)
        except OSError as error:
            raise LinkClosedError(f"receiving from PX4 failed: {error}") from error
        if not data:
            raise LinkClosedError("PX4 closed the connection")
        found = self._mav.parse_buffer(data) or []
        self.garbage_bytes += sum(len(m.data) for m in found if m.get_msgId() == _BAD_DATA)
        return [m for m in found if m.get_msgId() >= 0]

    def close(self) -> None:
        with contextlib.suppress(OSError):  # PX4 may already have closed the connection
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
