"""MAVLink over a serial line or a TCP connection that is reopened after a loss.

The line is reopened every half second. Outgoing frames wait in a bounded buffer; if it is full, a new frame
is dropped as a whole, so that the receiver never gets a part of one. Only ``wait`` blocks.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import time
from collections.abc import Callable, Sequence

from bridge.mavlink.transport.address import Peer
from bridge.mavlink.transport.transport import Chunk, EndpointCounters

RETRY_S = 0.5  # time between two tries to open a lost connection, s
_READ_BYTES = 4096  # maximum number of bytes of one read
_NOTICES_MAX = 32  # maximum number of texts that wait for ``take_notices``
OUTGOING_MAX = 4096  # maximum number of buffered bytes of TCP; less for a serial line
_FRAME_MAX = 280  # length of the longest frame, bytes; minimum size of every queue
_BITS_PER_BYTE = 10  # bits per byte on a serial line: a start bit, eight data bits, a stop bit (8N1)
_QUEUE_S = 0.1  # duration of the buffered frames on a serial line, s: an older set-point is useless
_KERNEL_QUEUE_S = 0.05  # duration of the bytes in the kernel's buffer, s
_CONNECT_MAX_S = 2.0  # time without reply after which a TCP connection attempt is given up, s
_UNANSWERED_MAX_MS = 2000  # time without acknowledgement after which a TCP connection counts as lost, ms
_SEND_BUFFER = 4096  # size of the kernel's buffer for TCP, bytes; small to limit the latency


class ByteStream:
    """A serial line or TCP connection that is reopened after a loss.

    ``name`` of the connection and ``peer`` of the other side are for notices and the log. ``connect`` opens a
    channel, or starts to. ``outgoing_max``: maximum number of bytes that wait.
    """

    is_stream = True
    local_port = 0

    def __init__(
        self,
        name: str,
        peer: Peer,
        connect: Callable[[], Channel],
        counters: EndpointCounters,
        *,
        baud: int | None = None,
        outgoing_max: int = OUTGOING_MAX,
    ) -> None:
        self.baud = baud
        self._name, self._peer, self._connect, self._counters = name, peer, connect, counters
        self._outgoing_max = outgoing_max
        self._channel: Channel | None = None
        self._was_up = self._closed = self._told = False
        self._lost_s = self._retry_s = time.monotonic()
        self._outgoing = bytearray()  # pending frames; the first one may be sent in part
        self._notices: list[str] = []
        self._nothing, self._never = socket.socketpair()  # a descriptor that is never readable

    def open_now(self) -> None:
        """Open the connection for the first time. Raises OSError: this is not possible."""
        self._channel = self._connect()
        self._look()

    def receive(self) -> Chunk | None:
        """Return the next bytes; None: no bytes have arrived."""
        channel = self._ready()
        if channel is None:
            return None
        try:
            data = channel.read(_READ_BYTES)
        except OSError as error:
            self._lose(error)
            return None
        if data is None:
            return None
        self._counters.bytes_in += len(data)
        return Chunk(data, self._peer)

    def send(self, frames: Sequence[bytes], _peer: Peer) -> None:
        """Send or buffer frames; without a connection or room they are dropped."""
        if self._ready() is None:
            self._counters.send_errors += len(frames)
            return
        for frame in frames:
            if len(self._outgoing) + len(frame) > self._outgoing_max:
                self._write()
            if self._channel is None or len(self._outgoing) + len(frame) > self._outgoing_max:
                self._counters.outgoing_full += 1
            else:
                self._outgoing += frame
        self._write()

    def wait(self, timeout_s: float) -> bool:
        """Wait for input and write pending frames meanwhile."""
        until_s = time.monotonic() + timeout_s
        while True:
            channel = self._ready()
            now_s = time.monotonic()
            left_s = max(0.0, until_s - now_s)
            if channel is None:
                left_s = min(left_s, max(0.0, self._retry_s - now_s) if self._channel is None else RETRY_S)
            pending = self._channel if channel is None or self._outgoing else None
            readable, writable, _ = select.select(
                (channel.fileno(),) if channel is not None else (),
                (pending.fileno(),) if pending is not None else (),
                (),
                min(left_s, RETRY_S),
            )
            if readable:
                return True
            if writable:
                self._write()
                if self._outgoing:  # wait while the slow line accepts bytes, to avoid a busy loop
                    time.sleep(min(left_s, 0.001))
            if time.monotonic() >= until_s:
                return False

    def fileno(self) -> int:
        """Descriptor of the connection; without one, a descriptor that is never readable."""
        channel = self._ready()
        return self._nothing.fileno() if channel is None else channel.fileno()

    def take_notices(self) -> list[str]:
        notices, self._notices = self._notices, []
        return notices

    def close(self) -> None:
        """Close the connection; may be called twice."""
        self._closed = True
        if self._channel is not None:
            self._write()
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        self._nothing.close()
        self._never.close()

    def _ready(self) -> Channel | None:
        """Return the connection, reopened when due; None if there is none."""
        if self._channel is None:
            now_s = time.monotonic()
            if self._closed or now_s < self._retry_s:
                return None
            self._retry_s = now_s + RETRY_S
            try:
                self._channel = self._connect()
            except OSError as error:
                self._fail(error)
                return None
        return self._look()

    def _look(self) -> Channel | None:
        """Return the established connection or None; report a new connection."""
        channel = self._channel
        assert channel is not None
        try:
            if not channel.established():
                return None
        except OSError as error:
            self._lose(error)
            return None
        if self._told:
            self._say(f"{self._name} is connected again after {time.monotonic() - self._lost_s:.1f} s")
        self._was_up, self._told = True, False
        return channel

    def _lose(self, error: OSError) -> None:
        """Close the connection and drop pending frames, which would be too old later."""
        if self._channel is not None:
            self._channel.close()
            self._channel = None
        self._outgoing.clear()
        self._retry_s = time.monotonic() + RETRY_S
        if self._was_up and not self._told:
            self._counters.connections_lost += 1
        self._fail(error)

    def _fail(self, error: OSError) -> None:
        if self._told:
            return
        self._told, self._lost_s = True, time.monotonic()
        what = "is lost" if self._was_up else "cannot be opened"
        self._say(f"{self._name} {what} ({error.strerror or error}): tried again every {RETRY_S:g} s")

    def _write(self) -> None:
        """Write pending bytes as long as there is room."""
        try:
            while self._channel is not None and self._outgoing:
                written = self._channel.write(self._outgoing)
                if not written:
                    return
                del self._outgoing[:written]
                self._counters.bytes_out += written
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error)

    def _say(self, text: str) -> None:
        self._notices = [*self._notices, text][-_NOTICES_MAX:]


def open_stream(kind: str, address: Peer, counters: EndpointCounters) -> ByteStream:
    """Open a serial line or TCP connection; ``address``: device and baud, or IPv4 address and port."""
    if kind == "tcp":
        name = f"TCP connection to {address[0]}:{address[1]}"
        return ByteStream(name, address, lambda: _TcpChannel(address), counters, outgoing_max=OUTGOING_MAX)
    device, baud = address
    stream = ByteStream(
        f"serial line {device}, {baud} baud",
        address,
        lambda: _SerialChannel(device, baud),
        counters,
        baud=baud,
        outgoing_max=_bytes_in(_QUEUE_S, baud),
    )
    stream.open_now()
    return stream


def _bytes_in(time_s: float, baud: int) -> int:
    """Return the number of bytes that a serial line transmits in a time; at least one frame."""
    return max(_FRAME_MAX, round(baud / _BITS_PER_BYTE * time_s))


# Channels have a non-blocking descriptor; their methods raise OSError when the connection is lost.


class _SerialChannel:
    """An open serial port. Raises OSError: it cannot be opened or set up."""

    def __init__(self, device: str, baud: int) -> None:
        import serial

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
        # Only a small part of the kernel's buffer is used, because the full buffer holds seconds of frames.
        # With a full buffer, pyserial's write would wait without limit.
        room = self._queue_max - self._port.out_waiting
        return os.write(self._port.fileno(), data[:room]) if room > 0 else 0

    def close(self) -> None:
        # The kernel's buffer is nearly empty; closing does not wait for a missing device.
        with contextlib.suppress(OSError):
            self._port.close()


_REASONS = {
    errno.ENOENT: "there is no such device: is it plugged in?",
    errno.EACCES: "no right to use it: is the user in the group dialout?",
    errno.EAGAIN: "another process has it open",
    errno.EBUSY: "another process has it open",
}


class _TcpChannel:
    """A connecting or established TCP connection. Raises OSError: it is refused immediately."""

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
        return self._socket.fileno()

    def established(self) -> bool:
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
        try:
            data = self._socket.recv(size)
        except BlockingIOError:
            return None
        if not data:
            raise OSError(errno.ECONNRESET, "the other side has closed it")
        return data

    def write(self, data: bytearray) -> int:
        return self._socket.send(data)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.close()


Channel = _SerialChannel | _TcpChannel
