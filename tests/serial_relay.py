"""Connects a UDP vehicle to a pseudo-terminal or TCP client, with the speed and errors of a serial line.

A thread passes bytes both ways. Each direction has its own bit rate, a small buffer, random bytes between
frames, and times in which the cable is disconnected.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import random
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mav

from flightstack.common.pacing import ask_for_priority
from tests.processes.ports import free_port

_TURN_S = 0.002  # period of the thread, s; 12 bytes at 57,600 baud
_PIECE = 256  # maximum number of bytes in a read
_NONE = bytes(4)  # result of FIONREAD if there are no bytes to read


class PtyEnd:
    """A pseudo-terminal under a fixed name; a disconnected cable removes the device."""

    def __init__(self, folder: Path, baud: int) -> None:
        self._link = folder / "ttyTEST"
        self.url = f"serial:{self._link}:{baud}"
        self._master = -1
        self.plug()

    def plug(self) -> None:
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(slave))
        self._slave = slave  # remains open, because a master without a slave reports a read error

    def pull(self) -> None:
        self._link.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)
        self._master = -1

    def read(self) -> bytes:
        with contextlib.suppress(OSError):  # an empty read would wait for a kernel worker
            empty = self._master < 0 or fcntl.ioctl(self._master, termios.FIONREAD, _NONE) == _NONE
            return b"" if empty else os.read(self._master, _PIECE)
        return b""

    def write(self, data: bytes) -> int:
        with contextlib.suppress(OSError):
            return os.write(self._master, data) if self._master >= 0 else len(data)
        return 0

    def close(self) -> None:
        if self._master >= 0:
            self.pull()


class TcpEnd:
    """A TCP server for one client at a time; a disconnected cable closes the connection."""

    def __init__(self) -> None:
        self._port = free_port()
        self.url = f"tcp:127.0.0.1:{self._port}"
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None
        self.plug()

    def plug(self) -> None:
        self._server = socket.socket()
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.bind(("127.0.0.1", self._port))
        self._server.listen(1)
        self._server.setblocking(False)

    def pull(self) -> None:
        for end in (self._client, self._server):
            if end is not None:
                end.close()
        self._client = self._server = None

    def read(self) -> bytes:
        if self._client is None and self._server is not None:
            with contextlib.suppress(BlockingIOError):
                self._client, _ = self._server.accept()
                self._client.setblocking(False)
        if self._client is None:
            return b""
        try:
            data = self._client.recv(_PIECE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._client.close()
            self._client = None
        return data

    def write(self, data: bytes) -> int:
        if self._client is None:
            return len(data)
        with contextlib.suppress(OSError):
            return self._client.send(data)
        return 0

    def close(self) -> None:
        self.pull()


# messages with precedence; an autopilot sends others only if its buffer is nearly empty (PX4: MAV_x_RATE)
_FIRST = frozenset({
    mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mav.MAVLINK_MSG_ID_ATTITUDE,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, mav.MAVLINK_MSG_ID_SYS_STATUS, mav.MAVLINK_MSG_ID_COMMAND_ACK,
    mav.MAVLINK_MSG_ID_PARAM_VALUE, mav.MAVLINK_MSG_ID_STATUSTEXT, mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    mav.MAVLINK_MSG_ID_TIMESYNC, mav.MAVLINK_MSG_ID_HOME_POSITION,
})  # fmt: skip


class Line:
    """One direction of the line: bytes are taken at once and sent at the bit rate; excess bytes are lost."""

    def __init__(self, baud: int | None) -> None:
        self._rate = baud / 10 if baud else None
        self._buffer_max = 65536 if baud is None else max(576, baud // 200)  # bytes of 0.05 s, at least 576
        self._buffer = bytearray()
        self._credit = 0.0

    def put_frames(self, datagram: bytes) -> None:
        """Write whole frames as an autopilot does: less important frames only into a nearly empty buffer."""
        while datagram:
            end = 12 + datagram[1]
            frame, datagram = datagram[:end], datagram[end:]
            first = int.from_bytes(frame[7:10], "little") in _FIRST
            room = self._buffer_max // (1 if first else 5) - len(self._buffer)
            if len(frame) <= room:
                self.put(frame)

    def put(self, data: bytes) -> None:
        room = self._buffer_max - len(self._buffer)
        self._buffer += data[:room]

    def carry(self, pieces: list[bytes], put: Callable[[bytes], None], elapsed_s: float) -> bytes:
        """Take pieces that arrived evenly spread over ``elapsed_s``; return the bytes sent in this time."""
        share_s = elapsed_s / (len(pieces) + 1)
        out = b""
        for piece in pieces:
            out += self.take(share_s)
            put(piece)
        return out + self.take(share_s)

    def take(self, elapsed_s: float) -> bytes:
        if self._rate is None:
            count = len(self._buffer)
        else:
            self._credit += self._rate * elapsed_s
            count = min(int(self._credit), len(self._buffer))
            self._credit -= count
            if count == len(self._buffer):
                # an idle line keeps at most 20 ms of unused bit rate
                self._credit = min(self._credit, self._rate * 0.02)
        out = bytes(self._buffer[:count])
        del self._buffer[:count]
        return out


class Relay:
    """Thread that passes bytes both ways until it is closed.

    ``near``: end at the onboard process; ``vehicle``: UDP port of the simulated vehicle on loopback;
    ``baud``: bit rate, None: no limit; ``noise_bytes_s``: random bytes a second among the vehicle's bytes.
    """

    def __init__(
        self, near: PtyEnd | TcpEnd, vehicle: int, baud: int | None, *, noise_bytes_s: float = 0.0
    ) -> None:
        self.near, self.in_line, self.out_line = near, Line(baud), Line(baud)
        self.noise_bytes = 0
        self._noise_bytes_s, self._chance = noise_bytes_s, random.Random(0)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind(("127.0.0.1", 0))
        self._udp.connect(("127.0.0.1", vehicle))
        self._udp.setblocking(False)
        self._wanted, self._is_in = True, True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def pull(self) -> None:
        self._wanted = False

    def plug(self) -> None:
        self._wanted = True

    def close(self) -> None:
        self._stop.set()
        self._thread.join(5.0)
        self._udp.close()
        self.near.close()

    def _run(self) -> None:
        ask_for_priority()  # the speed of the line must not depend on the machine's load
        then_s, noise, rest = time.monotonic(), 0.0, b""
        parser = mav.MAVLink(None)
        parser.robust_parsing = True
        while not self._stop.is_set():
            select.select((self._udp,), (), (), _TURN_S)
            now_s = time.monotonic()
            elapsed_s, then_s = now_s - then_s, now_s
            if self._wanted != self._is_in:
                (self.near.plug if self._wanted else self.near.pull)()
                self._is_in = self._wanted
            datagrams: list[bytes] = []
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                while True:
                    datagrams.append(self._udp.recv(65536))
            noise += self._noise_bytes_s * elapsed_s
            if noise >= 1.0:
                self.in_line.put(self._chance.randbytes(int(noise)))
                self.noise_bytes += int(noise)
                noise -= int(noise)
            rest += self.in_line.carry(datagrams, self.in_line.put_frames, elapsed_s)
            if rest and self._is_in:
                rest = rest[self.near.write(rest) :]
            written = list(iter(self.near.read, b""))
            carried = self.out_line.carry(written, self.out_line.put, elapsed_s)
            for message in parser.parse_buffer(carried) or ():
                with contextlib.suppress(ConnectionRefusedError, BlockingIOError):
                    self._udp.send(bytes(message.get_msgbuf()))  # a datagram contains whole frames
