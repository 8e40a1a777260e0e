"""Brings the log from the kernel to the disk itself, so that a power cut costs little, too.

A write is safe from a crash of the recorder at once, but the kernel may keep it for half a minute. The call
that waits for the disk may take long on a memory card, so it runs in a thread of its own, one at a time: the
recorder goes on reading meanwhile.
"""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path


class Syncer:
    """Calls ``fdatasync`` on one open file whenever asked and idle.

    Attributes:
        count: Calls so far.
        worst_s: Wall time of the longest one.
        failure: What the disk refused to keep; empty as long as all is well.
    """

    def __init__(self, descriptor: int, path: Path) -> None:
        """Start the thread; the name of the file in its directory is brought to the disk at once.

        Raises:
            OSError: The disk does not keep even the name.
        """
        _sync_directory(path.parent)
        self._descriptor = os.dup(descriptor)  # the file may be closed before the last wait
        self._wanted = threading.Event()
        self._closing = False
        self.count = 0
        self.worst_s = 0.0
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name="sync", daemon=True)
        self._thread.start()

    def ask(self) -> None:
        """Have everything written so far on the disk soon; never waits."""
        self._wanted.set()

    def close(self) -> None:
        """Wait for the disk a last time, with everything written so far, and end the thread."""
        self._closing = True
        self._wanted.set()
        self._thread.join()
        os.close(self._descriptor)

    def _work(self) -> None:
        closing = False
        while not closing:
            self._wanted.wait()
            self._wanted.clear()
            closing = self._closing  # read before the call, so that the last call comes after close()
            begun_s = time.monotonic()
            try:
                os.fdatasync(self._descriptor)
            except OSError as error:
                self.failure = error.strerror or str(error)
                return
            self.count += 1
            self.worst_s = max(self.worst_s, time.monotonic() - begun_s)


def _sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
