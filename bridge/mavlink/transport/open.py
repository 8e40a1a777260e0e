"""Opens the transport that a MAVLink URL names: UDP, or a byte stream over a serial line or TCP."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import socket
import struct
import termios
import time

from bridge.mavlink.transport.address import Peer, parse_url
from bridge.mavlink.transport.byte_stream import OUTGOING_MAX, ByteStream
from bridge.mavlink.transport.transport import DatagramTransport, LineCounters, Transport

_FRAME_MAX = 280  # bytes; one frame of the greatest length must fit into every queue
_BITS_PER_BYTE = 10  # on a serial line: a start bit, eight bits of data, a stop bit (8N1)
_QUEUE_S = 0.1  # s of buffered frames on a serial line: an older set-point is useless
_KERNEL_QUEUE_S = 0.05  # s of bytes in the kernel's buffer
_CONNECT_MAX_S = 2.0  # s until a TCP connection without reply is given up
_UNANSWERED_MAX_MS = 2000  # ms without acknowledgement until a TCP connection counts as lost
_SEND_BUFFER = 4096  # bytes of the kernel's buffer for TCP, small against delay


def open_transport(url: str, address: Peer, counters: LineCounters) -> Transport:
    """Open a URL of ``parse_url``; ``address``: IPv4 address and port, or device and baud.

    Raises OSError: it cannot be opened; a refused TCP connection is tried again instead.
    """
    kind = parse_url(url)[0]
    if kind == "serial":
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
    if kind == "tcp":
        name = f"TCP connection to {address[0]}:{address[1]}"
        return ByteStream(name, address, lambda: _TcpChannel(address), counters, outgoing_max=OUTGOING_MAX)
    return DatagramTransport(url, kind == "udpin", address, counters)


def _bytes_in(time_s: float, baud: int) -> int:
    """Bytes that a serial line carries in a time; at least one frame."""
    return max(_FRAME_MAX, round(baud / _BITS_PER_BYTE * time_s))


def _number(device: int, request: int) -> int:
    """Integer result of an ioctl request."""
    (answer,) = struct.unpack("i", fcntl.ioctl(device, request, bytes(4)))
    return int(answer)


class _SerialChannel:
    """An open serial port; OSError when it cannot be opened or set up."""

    def __init__(self, device: str, baud: int) -> None:
        import serial

        self._queue_max = _bytes_in(_KERNEL_QUEUE_S, baud)
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            number = getattr(error, "errno", None) or errno.EINVAL
            reason = _REASONS.get(number, str(error))
            raise OSError(number, f"serial port {device}: {reason}") from error
        try:
            self._fd: int = self._port.fileno()
            attributes = termios.tcgetattr(self._fd)
            attributes[6][termios.VMIN] = 1  # distinguishes an empty line from a hang-up
            termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        except (OSError, termios.error) as error:
            self._port.close()
            raise OSError(errno.EIO, f"{device} cannot be set up: {error}") from error

    def fileno(self) -> int:
        return self._fd

    def established(self) -> bool:
        return True

    def read(self, size: int) -> bytes | None:
        # Reading an empty line waits for a kernel worker (n_tty_read), up to 0.3 s on a busy machine.
        if _number(self._fd, termios.FIONREAD) == 0:  # OSError: the device is gone
            return None
        try:
            data = os.read(self._fd, size)
        except BlockingIOError:
            return None
        if not data:
            raise OSError(errno.EIO, "the device has gone")
        return data

    def write(self, data: bytes) -> int:
        # Only a small part of the kernel's buffer is used: it would hold seconds of frames.
        room = self._queue_max - _number(self._fd, termios.TIOCOUTQ)
        return os.write(self._fd, data[:room]) if room > 0 else 0

    def close(self) -> None:
        # The kernel's buffer is nearly empty; a missing device is not waited for.
        with contextlib.suppress(OSError):
            self._port.close()


_REASONS = {
    errno.ENOENT: "there is no such device: is it plugged in?",
    errno.EACCES: "no right to use it: is the user in the group dialout?",
    errno.EAGAIN: "another process has it open",
    errno.EBUSY: "another process has it open",
}


class _TcpChannel:
    """A connecting or established connection; OSError when it is refused at once."""

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

    def write(self, data: bytes) -> int:
        return self._socket.send(data)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.close()
