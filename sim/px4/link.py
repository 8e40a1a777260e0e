"""TCP server of PX4's simulator; it accepts one PX4 at a time."""

from __future__ import annotations

import contextlib
import re
import select
import socket
import struct
from collections.abc import Iterable, Sequence
from ipaddress import IPv4Address

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.transport.address import resolve
from sim.px4.plant import COMPONENT_ID, SYSTEM_ID

_ENDPOINT = re.compile(r"^([^:/\s]+):(\d{1,5})$")
_ENDPOINT_HELP = "allowed is HOST:PORT, PORT up to 65535 (0 takes a free one), for example 127.0.0.1:4560"
_CHUNK = 65536  # maximum bytes per read
_SEND_MAX_S = 5.0  # maximum time for which PX4's receive buffer may be full, s
_BAD_DATA: int = dialect.MAVLINK_MSG_ID_BAD_DATA  # negative, as is the id of unknown messages
SLICE_S = 0.1  # longest wait for the socket, s


class LinkClosedError(ConnectionError):
    """PX4 has closed the connection."""


def parse_endpoint(text: str, *, allow_unsigned: bool) -> tuple[str, int]:
    """Return address and port of ``HOST:PORT``."""
    match = _ENDPOINT.match(text)
    if match is None or int(match.group(2)) > 65535:
        raise ValueError(f"TCP endpoint {text!r} is not understood: {_ENDPOINT_HELP}")
    host, port = resolve(f"TCP endpoint {text!r}", match.group(1), int(match.group(2)), _ENDPOINT_HELP)
    if not IPv4Address(host).is_loopback and not allow_unsigned:
        raise ValueError(
            f"TCP endpoint {text!r} is open to a network, and PX4's simulator link knows no signatures: "
            "listen on 127.0.0.1, or say --allow-unsigned"
        )
    return host, port


def _timeval(seconds: float) -> bytes:
    return struct.pack("ll", int(seconds), round(seconds % 1.0 * 1e6))


class Px4Link:
    def __init__(self, connected: socket.socket) -> None:
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # The operating system's time-outs are used, because Python's need two system calls per message.
        connected.settimeout(None)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(_SEND_MAX_S))
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _timeval(SLICE_S))
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
        """Return the messages, of MAVLink 1 and 2, received within ``timeout_s``, at most ``SLICE_S``."""
        if timeout_s < SLICE_S and not select.select([self._socket], [], [], max(0.0, timeout_s))[0]:
            return ()
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:  # time-out without data
            return ()
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


class Px4Server:
    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((host, port))
            self._socket.listen(1)  # a second PX4 waits until the first disconnects
        except OSError as error:
            self._socket.close()
            raise OSError(
                f"cannot listen on {host}:{port}: {error.strerror}; is another simulator running there?"
            ) from error

    @property
    def port(self) -> int:
        return int(self._socket.getsockname()[1])

    def accept(self) -> Px4Link | None:
        """Return the next connection; None: no PX4 has connected within ``SLICE_S``."""
        if not select.select([self._socket], [], [], SLICE_S)[0]:
            return None
        return Px4Link(self._socket.accept()[0])

    def close(self) -> None:
        self._socket.close()
