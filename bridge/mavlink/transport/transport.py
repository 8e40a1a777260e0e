"""UDP for a MAVLink endpoint, and the text of its counters; ``byte_stream`` has serial lines and TCP."""

from __future__ import annotations

import select
import socket
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from bridge.mavlink.transport.address import Peer, local_host_for


class Chunk(NamedTuple):
    data: bytes
    peer: Peer


_PASSED = ("received", "sent", "bytes_in", "bytes_out", "stale_answered")


def dropped(counters: Counter[str]) -> str:
    """Return the numbers of all dropped data as one line (names: docs/how_to/security.md); empty: none."""
    return ", ".join(f"{name} {n}" for name, n in sorted(counters.items()) if n and name not in _PASSED)


_RECEIVED_MAX = 4096  # largest datagram, bytes; more than an Ethernet frame
_DATAGRAM_MAX = 1400  # longest sent datagram, bytes; PX4's buffer has 1600 (mavlink_receiver.cpp)
_SOCKET_BUFFER = 1 << 20  # requested size of the buffer, bytes; the kernel may grant less


class DatagramTransport:
    """A UDP socket; without listening it has ``address`` as its only peer. Only ``wait`` blocks."""

    baud: int | None = None
    is_stream = False

    def __init__(self, url: str, listens: bool, address: Peer, counters: Counter[str]) -> None:
        self._counters = counters
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BUFFER)
            if listens:
                self._socket.bind(address)
            else:
                self._socket.bind((local_host_for(address), 0))
                self._socket.connect(address)  # the kernel then drops frames of other senders
        except OSError as error:
            self._socket.close()
            hint = "is another process listening there?" if listens else "is there a route to it?"
            raise OSError(error.errno, f"cannot open {url!r}: {error.strerror}; {hint}") from error
        self.local_port: int = self._socket.getsockname()[1]
        self._readable = select.poll()
        self._readable.register(self._socket, select.POLLIN)

    def receive(self) -> Chunk | None:
        """Return one datagram; None: no datagram. An oversized one is counted and returned empty."""
        if not self._readable.poll(0):  # the poll takes a third of the time of an empty recvfrom
            return None
        try:
            datagram, peer = self._socket.recvfrom(_RECEIVED_MAX + 1)
        except BlockingIOError:
            return None
        except OSError:  # the port of a peer, or the local port, was closed
            return Chunk(b"", ("", 0))
        self._counters["bytes_in"] += len(datagram)
        if len(datagram) > _RECEIVED_MAX:
            self._counters["oversize"] += 1
            return Chunk(b"", peer)
        return Chunk(datagram, peer)

    def send(self, frames: Sequence[bytes], peer: Peer) -> None:
        """Send frames in order in one datagram (in several above 1400 bytes)."""
        for datagram in _datagrams(frames):
            self._send(datagram, peer)

    def wait(self, timeout_s: float) -> bool:
        return bool(self._readable.poll(1e3 * timeout_s))

    def fileno(self) -> int:
        return self._socket.fileno()

    def take_notices(self) -> list[str]:
        """Return no notice, because UDP has no connection that could be lost."""
        return []

    def close(self) -> None:
        self._socket.close()

    def _send(self, datagram: bytes, peer: Peer) -> None:
        for _ in range(2):
            try:
                self._counters["bytes_out"] += self._socket.sendto(datagram, peer)
            except ConnectionRefusedError:
                continue  # the error belongs to an earlier datagram; send this datagram again
            except OSError:  # full buffer or no route: a newer frame follows in the next tick
                self._counters["send_errors"] += 1
            return
        self._counters["send_errors"] += 1


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
