"""A TCP connection to a vehicle, not blocking, for :class:`.byte_stream.ByteStream`."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import time

from bridge.mavlink.transport.address import Peer
from bridge.mavlink.transport.byte_stream import Channel

_CONNECT_MAX_S = 2.0  # s until a connection that nobody answers is given up
_UNANSWERED_MAX_MS = 2000  # ms that sent bytes may stay unacknowledged: a peer that vanished is then noticed
_SEND_BUFFER = 4096  # bytes, asked of the kernel: what waits there is old when it goes out


class TcpChannel:
    """A connection, being opened or open.

    Args:
        address: of the vehicle.

    Raises:
        OSError: it is refused at once.
    """

    def __init__(self, address: Peer) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._established = False
        self._until_s = time.monotonic() + _CONNECT_MAX_S
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            if hasattr(socket, "TCP_USER_TIMEOUT"):
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNANSWERED_MAX_MS)
            number = self._socket.connect_ex(address)
            if number not in (0, errno.EINPROGRESS):
                raise OSError(number, os.strerror(number))
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """Descriptor."""
        return self._socket.fileno()

    def established(self) -> bool:
        """Whether the other side has answered; OSError when it refused, or did not within two seconds."""
        if self._established:
            return True
        _, writable, _ = select.select((), (self._socket,), (), 0)
        if not writable:
            if time.monotonic() > self._until_s:
                raise OSError(errno.ETIMEDOUT, f"no answer within {_CONNECT_MAX_S:g} s")
            return False
        number = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if number:
            raise OSError(number, os.strerror(number))
        self._established = True
        return True

    def read(self, size: int) -> bytes | None:
        """Bytes that are there, None when there are none now; OSError when the connection has ended."""
        try:
            data = self._socket.recv(size)
        except BlockingIOError:
            return None
        if not data:
            raise OSError(errno.ECONNRESET, "the other side has closed it")
        return data

    def write(self, data: bytes) -> int:
        """Hand over as many bytes as there is room for now."""
        return self._socket.send(data)

    def close(self) -> None:
        """Close it."""
        with contextlib.suppress(OSError):
            self._socket.close()


def open_tcp(address: Peer) -> Channel:
    """Begin to open a connection.

    Raises:
        OSError: it is refused at once.
    """
    return TcpChannel(address)
