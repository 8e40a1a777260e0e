"""What carries the bytes of a MAVLink endpoint: UDP, which is here, a serial line or a TCP connection."""

from __future__ import annotations

import select
import socket
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from bridge.mavlink.transport.address import Peer, local_host_for


class Chunk(NamedTuple):
    """Bytes that arrived together."""

    data: bytes
    peer: Peer


class LineCounters(Protocol):
    """Counts that a transport keeps."""

    bytes_in: int
    bytes_out: int
    send_errors: int
    oversize: int
    outgoing_full: int
    connections_lost: int


class Transport(Protocol):
    """One way to the other side. Nothing of it ever blocks but ``wait``, and that is bounded."""

    local_port: int  # UDP or TCP port of ours; 0 where there is none
    baud: int | None  # bits a second of a serial line, None where the speed is not known
    is_stream: bool  # chunks are pieces of one stream, cut anywhere; else each stands alone

    def receive(self) -> Chunk | None:
        """Take the next bytes; None when there are none now. Never raises."""

    def send(self, frames: Sequence[bytes], peer: Peer) -> None:
        """Send whole frames, in order; what does not go is dropped whole and counted. Never raises."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until there is something to receive; False when nothing came in ``timeout_s``."""

    def fileno(self) -> int:
        """Descriptor that becomes readable when something can be received; it may change after a loss."""

    def take_notices(self) -> list[str]:
        """Texts about the connection since the last call: lost, found again."""

    def close(self) -> None:
        """Close it; may be called twice."""


_RECEIVED_MAX = 4096  # bytes of a datagram that is looked at; nobody joins frames beyond an Ethernet frame
_DATAGRAM_MAX = 1400  # bytes; below an Ethernet frame and PX4's 1600-byte buffer (mavlink_receiver.cpp)
_SOCKET_BUFFER = 1 << 20  # bytes, asked for; the kernel may give less


class DatagramTransport:
    """A UDP socket; see :class:`bridge.mavlink.transport.open.Transport`.

    One that does not listen sends to the address, and hears nobody else.

    Raises OSError: the address cannot be bound, or there is no route to it.
    """

    baud: int | None = None
    is_stream = False

    def __init__(self, url: str, listens: bool, address: Peer, counters: LineCounters) -> None:
        self._counters = counters
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BUFFER)
            if listens:
                self._socket.bind(address)
            else:
                self._socket.bind((local_host_for(address), 0))
                self._socket.connect(address)  # the kernel drops what comes from elsewhere
        except OSError as error:
            self._socket.close()
            hint = "is another process listening there?" if listens else "is there a route to it?"
            raise OSError(error.errno, f"cannot open {url!r}: {error.strerror}; {hint}") from error
        self.local_port: int = self._socket.getsockname()[1]
        self._readable = select.poll()
        self._readable.register(self._socket, select.POLLIN)

    def receive(self) -> Chunk | None:
        """Take one datagram; None when there is none. What is too long comes back empty, and is counted."""
        if not self._readable.poll(0):  # a third of what a call costs that finds nothing
            return None
        try:
            datagram, peer = self._socket.recvfrom(_RECEIVED_MAX + 1)
        except BlockingIOError:
            return None
        except OSError:  # a peer's port was closed, or ours: nothing to mend here
            return Chunk(b"", ("", 0))
        self._counters.bytes_in += len(datagram)
        if len(datagram) > _RECEIVED_MAX:
            self._counters.oversize += 1
            return Chunk(b"", peer)
        return Chunk(datagram, peer)

    def send(self, frames: Sequence[bytes], peer: Peer) -> None:
        """Send frames, in order, in one datagram (more only when they exceed 1400 bytes)."""
        for datagram in _datagrams(frames):
            self._send(datagram, peer)

    def wait(self, timeout_s: float) -> bool:
        """Wait until a datagram is there; False when none came in time."""
        return bool(self._readable.poll(1e3 * timeout_s))

    def fileno(self) -> int:
        """Descriptor of the socket."""
        return self._socket.fileno()

    def take_notices(self) -> list[str]:
        """Nothing: UDP has no connection that could be lost."""
        return []

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self._socket.close()

    def _send(self, datagram: bytes, peer: Peer) -> None:
        for _ in range(2):
            try:
                self._counters.bytes_out += self._socket.sendto(datagram, peer)
            except ConnectionRefusedError:
                continue  # says that an earlier datagram found no listener: not about this one
            except OSError:  # full buffer or no route: the caller sends again next tick
                self._counters.send_errors += 1
            return
        self._counters.send_errors += 1


def _datagrams(frames: Sequence[bytes]) -> list[bytes]:
    """Join frames, in order, into as few datagrams as the size limit allows."""
    if sum(map(len, frames)) <= _DATAGRAM_MAX:
        return [b"".join(frames)]
    datagrams: list[bytes] = []
    current = b""
    for frame in frames:
        if current and len(current) + len(frame) > _DATAGRAM_MAX:
            datagrams.append(current)
            current = b""
        current += frame
    return [*datagrams, current]
