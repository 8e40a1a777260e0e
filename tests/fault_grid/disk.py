"""A real recorder in a thread, on a simulated disk that fails on command."""

from __future__ import annotations

import errno
import io
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any
from unittest import mock

from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from flightstack.onboard.log import OnboardLog
from flightstack.onboard.runner import Taken
from logs.reader.reader import LogFile
from logs.recorder import feed as feed_module
from logs.recorder import recorder as recorder_process
from logs.recorder.feed import Feed
from logs.recorder.recorder import RecorderProcess
from logs.recorder.recording import McapFile, SafeStream
from logs.schema import Names
from tests.fault_grid.flight import Flight
from tests.fault_grid.table import Way

SLOW_B_S = 1e6  # write speed of a slow disk, bytes/s; a memory card is ten times faster
LATE_S = 0.2  # delay of a late disk before each block of data, s
BLOCK_B = 4096
CLOSE_S = 0.3  # time-out of the feed for a disk that hangs, s
END_S = 30.0  # time-out for the recorder's end, s of wall time


class Disk(io.RawIOBase):
    """A file on a disk that fails as specified after ``fail``; ``heal`` ends a hang."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._way: Way | None = None
        self._healed = threading.Event()
        self._writes = 0
        self._ways: Mapping[Way, Callable[[bytes], int]] = MappingProxyType(
            {
                Way.OFF: lambda data: self._refuse(errno.ENOSPC),
                Way.STUCK: self._hang,
                Way.GARBAGE: self._damage,
                Way.WRONG: lambda data: self._refuse(errno.EROFS),
                Way.SLOW: lambda data: self._late(data, len(data) / SLOW_B_S),
                Way.DELAYED: lambda data: self._late(data, LATE_S * (len(data) >= BLOCK_B)),
                Way.INTERMITTENT: self._now_and_then,
            }
        )

    def fail(self, way: Way) -> None:
        self._way = way

    def heal(self) -> None:
        """Release the writes that a hanging disk blocks."""
        self._healed.set()

    def write(self, data: Any) -> int:
        data = bytes(data)
        return self._file.write(data) if self._way is None else self._ways[self._way](data)

    def fileno(self) -> int:
        return self._file.fileno()

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def truncate(self, size: int | None = None) -> int:
        return self._file.truncate(size)

    def close(self) -> None:
        self._file.close()

    def _refuse(self, number: int) -> int:
        raise OSError(number, os.strerror(number))

    def _damage(self, data: bytes) -> int:
        at = len(data) // 2
        return self._file.write(data[:at] + bytes((data[at] ^ 0x5A,)) + data[at + 1 :])

    def _hang(self, data: bytes) -> int:
        self._healed.wait(END_S)
        return self._refuse(errno.EIO)

    def _late(self, data: bytes, seconds: float) -> int:
        time.sleep(seconds)  # delay of the simulated disk
        return self._file.write(data)

    def _now_and_then(self, data: bytes) -> int:
        self._writes += 1
        return self._refuse(errno.EIO) if self._writes % 3 == 0 else self._file.write(data)


class _NoSession:
    """Replaces the Zenoh session; it has no subscribers."""

    def declare_publisher(self, *_: object, **__: object) -> _NoSession:
        return self

    def put(self, *_: object, **__: object) -> None:
        return


class Recording:
    """A running recorder and the companion's connection to it.

    ``failure``: error that stopped the recorder, empty without an error; ``dropped``: number of records
    that the companion dropped.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "flight.mcap"
        self.failure, self.dropped = "", 0
        disks: list[Disk] = []

        def on_disk(path: Path) -> McapFile:
            disks.append(Disk(path))
            return McapFile(path, stream=SafeStream(disks[0]))  # type: ignore[arg-type]

        with mock.patch.object(recorder_process, "McapFile", on_disk):
            self._recorder = RecorderProcess(folder / "recorder", self.path)
        self.disk = disks[0]
        self._thread = threading.Thread(target=self._record, daemon=True)
        self._thread.start()
        self._feed = Feed.connect(str(folder / "recorder"), "onboard", lossless=False)
        self._log: OnboardLog | None = None

    def attach(self, flight: Flight) -> None:
        self._log = OnboardLog(
            self._feed, _NoSession(), Names("cf1", 1), flight.controller.config, lockstep=False
        )
        controller, log = flight.controller, self._log

        def step(tick: Tick, taken: Taken, out: Outputs) -> None:
            log.step(tick, taken, out, controller)
            log.timing(tick, out, 0.0, self._feed.dropped)

        flight.on_step = step

    def end(self) -> None:
        """Close everything. Raises RuntimeError: the recorder hangs."""
        with mock.patch.object(feed_module, "PATIENCE_S", CLOSE_S):
            self._feed.close()
        self.dropped = self._feed.dropped
        self.disk.heal()
        self._recorder.stop()
        self._thread.join(END_S)
        if self._thread.is_alive():
            raise RuntimeError(f"the recorder did not end within {END_S:g} s")

    def says(self) -> str:
        """Return the first problem of recorder, companion or log file; all of them must be closed."""
        if self.failure:
            return f"recorder: {self.failure}"
        if self.dropped:
            return f"companion: {self.dropped} records dropped"
        log = LogFile(self.path)
        messages = sum(1 for _ in log.messages())
        if log.problem or not log.complete:
            return f"file: {log.problem or 'not complete'}"
        return f"nothing: all {messages} messages are there"

    def _record(self) -> None:
        self.failure = self._recorder.run().failure


@contextmanager
def recording(folder: Path) -> Iterator[Recording]:
    """Start a recorder with a simulated disk; the context ends it."""
    one = Recording(folder)
    try:
        yield one
    finally:
        one.end()
