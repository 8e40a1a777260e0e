"""The transports of a MAVLink endpoint: UDP, serial lines and TCP connections, and the text of its counters.

After a loss, a serial line or TCP connection is tried again every half second. Outgoing frames wait in a
bounded buffer. If the buffer is full, a new frame is dropped as a whole, so that the receiver never gets a
part of a frame. Only ``wait`` blocks.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import select
import socket
import time
from collections import Counter, deque
from collections.abc import Sequence

from bridge.mavlink.transport.address import Peer

Chunk = tuple[bytes, Peer]  # data and their sender

_PASSED = ("received", "sent", "bytes_in", "bytes_out", "unknown_frames", "stale_answered")


def dropped(counters: Counter[str]) -> str:
    """Return the numbers of all dropped data as one line (names: docs/how_to/security.md); empty: none."""
    return ", ".join(f"{name} {n}" for name, n in sorted(counters.items()) if n and name not in _PASSED)


_RECEIVED_MAX = 4096  # maximum length of an accepted datagram, bytes; more than an Ethernet frame
_DATAGRAM_MAX = 1400  # maximum length of a sent datagram, bytes; PX4's buffer has 1600 (mavlink_receiver.cpp)
_SOCKET_BUFFER = 1 << 20  # requested size of the receive buffer, bytes; the kernel may grant less


class DatagramTransport:
    """A UDP socket; a socket that does not listen has ``address`` as its only peer. Only ``wait`` blocks."""

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
                # the kernel chooses the local address on the route, and drops frames of other senders
                self._socket.connect(address)
        except OSError as error:
            self._socket.close()
            hint = "is another process listening there?" if listens else "is there a route to it?"
            raise OSError(error.errno, f"cannot open {url!r}: {error.strerror}; {hint}") from error
        self.local_port: int = self._socket.getsockname()[1]
        self._readable = select.poll()
        self._readable.register(self._socket, select.POLLIN)

    def receive(self) -> Chunk | None:
        """Return one datagram; None: no datagram. An oversized datagram is counted and returned empty."""
        if not self._readable.poll(0):  # the poll takes a third of the time of an empty recvfrom
            return None
        try:
            datagram, peer = self._socket.recvfrom(_RECEIVED_MAX + 1)
        except BlockingIOError:
            return None
        except OSError:  # the port of a peer, or the local port, was closed
            return b"", ("", 0)
        self._counters["bytes_in"] += len(datagram)
        if len(datagram) > _RECEIVED_MAX:
            self._counters["oversize"] += 1
            return b"", peer
        return datagram, peer

    def send(self, frames: Sequence[bytes], peer: Peer) -> None:
        """Send frames in order in one datagram (in several above 1400 bytes)."""
        for datagram in _datagrams(frames):
            self._send(datagram, peer)

    def wait(self, timeout_s: float) -> bool:
        return bool(self._readable.poll(1e3 * timeout_s))

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()

    def _send(self, datagram: bytes, peer: Peer) -> None:
        for _ in range(2):
            try:
                self._counters["bytes_out"] += self._socket.sendto(datagram, peer)
                return
            except ConnectionRefusedError:
                continue  # the error belongs to an earlier datagram; send this datagram again
            except OSError:  # full buffer or no route: a newer frame follows in the next tick
                break
        self._counters["send_errors"] += 1


def _datagrams(frames: Sequence[bytes]) -> list[bytes]:
    """Join frames, in order, into as few datagrams as the size limit allows."""
    datagrams = [b""]
    for frame in frames:
        if datagrams[-1] and len(datagrams[-1]) + len(frame) > _DATAGRAM_MAX:
            datagrams.append(b"")
        datagrams[-1] += frame
    return datagrams


RETRY_S = 0.5  # time between two tries to open a lost connection, s
_READ_BYTES = 4096  # maximum number of bytes of one read
_SLICE_S = 0.005  # maximum wait between two writes of pending bytes, s
_OUTGOING_MAX = 4096  # maximum number of buffered bytes of a TCP connection
_FRAME_MAX = 280  # length of the longest frame, bytes; minimum size of a serial line's queues
_BITS_PER_BYTE = 10  # bits per byte on a serial line: a start bit, eight data bits, a stop bit (8N1)
_QUEUE_S = 0.1  # maximum transmission time of buffered frames on a serial line, s: old set-points are useless
_KERNEL_QUEUE_S = 0.05  # maximum transmission time of the bytes in the kernel's buffer, s
_CONNECT_MAX_S = 2.0  # time without reply after which a TCP connection attempt is given up, s
_UNANSWERED_MAX_MS = 2000  # time without acknowledgement after which a TCP connection counts as lost, ms
_SEND_BUFFER = 4096  # size of the kernel's buffer for TCP, bytes; small to limit the latency


class ByteStream:
    """A serial line or TCP connection that is reopened after a loss."""

    is_stream = True
    local_port = 0

    def __init__(self, kind: str, address: Peer, counters: Counter[str], notices: deque[str]) -> None:
        """``address``: device and baud ("serial") or IPv4 address and port ("tcp").

        ``notices`` receives texts for the operator. Raises OSError: the serial line cannot be opened; a
        refused TCP connection is tried again.
        """
        host, number = address
        self.baud = number if kind == "serial" else None
        self._name = (
            f"serial line {host}, {number} baud" if self.baud else f"TCP connection to {host}:{number}"
        )
        self._outgoing_max = _bytes_in(_QUEUE_S, number) if self.baud else _OUTGOING_MAX
        self._peer, self._counters, self._notices = address, counters, notices
        self._channel: Channel | None = None
        self._was_up = self._told = False  # whether a connection ever existed; whether a loss is reported
        self._lost_s = self._retry_s = time.monotonic()
        self._outgoing = bytearray()  # pending frames; a part of the first frame may have been sent
        self._nothing = socket.socketpair()  # descriptors that are never readable
        if self.baud is not None:
            self._channel = _SerialChannel(address)

    def receive(self) -> Chunk | None:
        """Return the next bytes; None: no bytes have arrived."""
        channel = self._ready()
        try:
            data = channel.read(_READ_BYTES) if channel is not None else None
        except OSError as error:
            self._lose(error)
            return None
        if data is None:
            return None
        self._counters["bytes_in"] += len(data)
        return data, self._peer

    def send(self, frames: Sequence[bytes], _peer: Peer) -> None:
        """Send or buffer frames; without a connection or room the frames are dropped."""
        for frame in frames:
            if self._ready() is None:
                self._counters["send_errors"] += 1
            elif len(self._outgoing) + len(frame) > self._outgoing_max:
                self._counters["outgoing_full"] += 1
            else:
                self._outgoing += frame
        self._ready()

    def wait(self, timeout_s: float) -> bool:
        """Wait for input and write pending frames; return whether there is input."""
        until_s = time.monotonic() + timeout_s
        while True:
            channel, left_s = self._ready(), max(0.0, until_s - time.monotonic())
            inputs = () if channel is None else (channel.fileno(),)
            if select.select(inputs, (), (), min(left_s, _SLICE_S))[0]:
                return True
            if not left_s:
                return False

    def fileno(self) -> int:
        """Descriptor of the connection; without a connection, a descriptor that is never readable."""
        channel = self._ready()
        return self._nothing[0].fileno() if channel is None else channel.fileno()

    def close(self) -> None:
        """Close the connection; may be called twice."""
        self._retry_s = math.inf
        if self._ready() is not None:
            self._close_channel()
        for end in self._nothing:
            end.close()

    def _ready(self) -> Channel | None:
        """Reopen a lost connection when due, write pending bytes; return the connection, or None."""
        try:
            if self._channel is None:
                if time.monotonic() < self._retry_s:
                    return None
                self._channel = (_SerialChannel if self.baud is not None else _TcpChannel)(self._peer)
            if not self._channel.established():
                return None
            if self._told:
                lost_s = time.monotonic() - self._lost_s
                self._notices.append(f"{self._name} is connected again after {lost_s:.1f} s")
            self._was_up, self._told = True, False
            while self._outgoing and (written := self._channel.write(self._outgoing)):
                del self._outgoing[:written]
                self._counters["bytes_out"] += written
        except BlockingIOError:  # the kernel's buffer has no room
            pass
        except OSError as error:
            self._lose(error)
        return self._channel

    def _lose(self, error: OSError) -> None:
        """Close the connection and drop pending frames, which would be too old later."""
        self._close_channel()
        self._outgoing.clear()
        now_s = time.monotonic()
        self._retry_s = now_s + RETRY_S
        if not self._told:
            self._told, self._lost_s = True, now_s
            self._counters["connections_lost"] += self._was_up
            what = "is lost" if self._was_up else "cannot be opened"
            reason = error.strerror or error
            self._notices.append(f"{self._name} {what} ({reason}): tried again every {RETRY_S:g} s")

    def _close_channel(self) -> None:
        if self._channel is not None:
            self._channel.close()
            self._channel = None


def _bytes_in(time_s: float, baud: int) -> int:
    """Return the number of bytes that a serial line transmits in a time; at least one frame."""
    return max(_FRAME_MAX, round(baud / _BITS_PER_BYTE * time_s))


# The channels below use a non-blocking descriptor; their methods raise OSError if the connection is lost.


class _SerialChannel:
    """An open serial port. Raises OSError: it cannot be opened or set up."""

    def __init__(self, address: Peer) -> None:
        import serial

        device, baud = address
        self._queue_max = _bytes_in(_KERNEL_QUEUE_S, baud)
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            number = getattr(error, "errno", None) or errno.EINVAL
            reason = _REASONS.get(number, str(error))
            raise OSError(number, f"serial port {device}: {reason}") from error

    def fileno(self) -> int:
        return int(self._port.fileno())

    def established(self) -> bool:
        return True

    def read(self, size: int) -> bytes | None:
        # Reading an empty line waits for a kernel worker (n_tty_read), up to 0.3 s on a busy machine.
        waiting: int = self._port.in_waiting  # raises OSError if the device is gone
        return bytes(self._port.read(min(waiting, size))) if waiting else None

    def write(self, data: bytearray) -> int:
        # Only a small part of the kernel's buffer is used, because a full buffer delays frames by seconds.
        # With a full buffer, pyserial's write would wait without limit.
        room = self._queue_max - self._port.out_waiting
        return os.write(self._port.fileno(), data[:room]) if room > 0 else 0

    def close(self) -> None:
        # The kernel's buffer is nearly empty, so closing does not wait, even if the device is missing.
        with contextlib.suppress(OSError):
            self._port.close()


_REASONS = {
    errno.ENOENT: "there is no such device: is it plugged in?",
    errno.EACCES: "no right to use it: is the user in the group dialout?",
    errno.EAGAIN: "another process has it open",
    errno.EBUSY: "another process has it open",
}


class _TcpChannel(socket.socket):
    """A connecting or established TCP connection. Raises OSError: it is refused immediately."""

    def __init__(self, address: Peer) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self._established = False
        self._until_s = time.monotonic() + _CONNECT_MAX_S
        try:
            self.setblocking(False)
            self.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            if hasattr(socket, "TCP_USER_TIMEOUT"):
                self.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNANSWERED_MAX_MS)
            _raise_for(self.connect_ex(address))
        except OSError:
            self.close()
            raise

    def established(self) -> bool:
        if self._established:
            return True
        if select.select((), (self,), (), 0)[1]:
            _raise_for(self.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR))
            self._established = True
        elif time.monotonic() > self._until_s:
            raise OSError(errno.ETIMEDOUT, f"no answer within {_CONNECT_MAX_S:g} s")
        return self._established

    def read(self, size: int) -> bytes | None:
        try:
            data = self.recv(size)
        except BlockingIOError:
            return None
        if not data:
            raise OSError(errno.ECONNRESET, "the other side has closed it")
        return data

    write = socket.socket.send


def _raise_for(number: int) -> None:
    if number not in (0, errno.EINPROGRESS):
        raise OSError(number, os.strerror(number))


Channel = _SerialChannel | _TcpChannel
