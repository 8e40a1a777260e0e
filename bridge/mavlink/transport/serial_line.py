"""A serial line by pyserial, not blocking, for :class:`bridge.mavlink.transport.byte_stream.ByteStream`."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import termios

import serial

from bridge.mavlink.transport.byte_stream import Channel

_QUEUE_MAX_S = 0.05  # s of bytes that may wait in the kernel: what waits longer is old when it goes out
BITS_PER_BYTE = 10  # on the line: a start bit, eight bits of data, a stop bit (8N1)
_CLOSED = errno.EIO


class SerialChannel:
    """An open serial port.

    Args:
        device: path, for example /dev/ttyACM0.
        baud: bits a second.

    Raises:
        OSError: it cannot be opened or set up.
    """

    def __init__(self, device: str, baud: int) -> None:
        self._queue_max = max(280, int(baud / BITS_PER_BYTE * _QUEUE_MAX_S))  # bytes; one frame at least
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            number = getattr(error, "errno", None) or errno.EINVAL
            raise OSError(number, _hint(device, number, error)) from error
        try:
            self._fd: int = self._port.fileno()
            attributes = termios.tcgetattr(self._fd)
            attributes[6][termios.VMIN] = 1  # no bytes is then told apart from a line that hung up
            termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        except (OSError, termios.error) as error:
            self._port.close()
            raise OSError(_CLOSED, f"{device} cannot be set up: {error}") from error

    def fileno(self) -> int:
        """Descriptor."""
        return self._fd

    def established(self) -> bool:
        """A port is open at once."""
        return True

    def read(self, size: int) -> bytes | None:
        """Bytes that are there, None when there are none now; OSError when the device has gone."""
        try:
            data = os.read(self._fd, size)
        except BlockingIOError:
            return None
        if not data:
            raise OSError(_CLOSED, "the device has gone")
        return data

    def write(self, data: bytes) -> int:
        """Hand over bytes as long as little waits in the kernel, whose buffer would hold seconds of them."""
        queued = struct.unpack("I", fcntl.ioctl(self._fd, termios.TIOCOUTQ, bytes(4)))[0]
        room = self._queue_max - queued
        return os.write(self._fd, data[:room]) if room > 0 else 0

    def close(self) -> None:
        """Close it; little waits in the kernel, and of a device that has gone nothing is waited for."""
        with contextlib.suppress(OSError):
            self._port.close()


def open_serial(device: str, baud: int) -> Channel:
    """Open a serial port.

    Raises:
        OSError: it cannot be opened.
    """
    return SerialChannel(device, baud)


def _hint(device: str, number: int, error: Exception) -> str:
    reasons = {
        errno.ENOENT: "there is no such device: is it plugged in?",
        errno.EACCES: "no right to use it: is the user in the group dialout?",
        errno.EAGAIN: "another process has it open",
        errno.EBUSY: "another process has it open",
    }
    return f"serial port {device}: {reasons.get(number, str(error))}"
