"""The flight recorder: one process, many clients, one MCAP file.

It is a process of its own, so it outlives a crash of the others, closes the file then, and its disk and
compressor never stand in the way of the control loop.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from flightstack.common.hangup import ASK, begun, on_hangup
from logs.recorder.recorder_process import RecorderError, RecorderProcess, Source
from logs.recorder.recording import Statistics
from logs.schema.schemas import typestore

__all__ = ["RecorderError", "RecorderProcess", "problems", "record_main"]


def record_main(
    socket_path: Path | None,
    out: Path,
    until_clients: int | None = None,
    *,
    connect: Sequence[str] = (),
    keys: Sequence[str] = (),
    config_file: Path | None = None,
) -> int:
    """Run the recorder as the main program of a process; prints "ready" once it listens.

    Returns:
        Exit status: 0 everything is in the file, 1 something is not, 2 it could not start.
    """
    if socket_path is None and not keys:
        print("record: nothing to record; give a socket or Zenoh keys", file=sys.stderr)
        return 2
    source: Source | None = None
    try:
        if keys:
            from logs.recorder.record_zenoh import ZenohSource

            source = ZenohSource(connect, keys, config_file)
        process = RecorderProcess(socket_path, out, source)
    except RecorderError as error:
        if source:
            source.close()
        print(f"record: {error}", file=sys.stderr)
        return 2

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        process.stop()

    for number in ASK:
        signal.signal(number, stop)
    on_hangup(stop)
    begun()
    typestore()  # half a second of work the first time: not in the middle of a flight
    print("ready", flush=True)
    counts = process.run(until_clients)
    for problem in problems(counts):
        print(f"record: {out}: {problem}", file=sys.stderr)
    return 1 if problems(counts) else 0


def problems(counts: Statistics) -> list[str]:
    """Return one line for each way in which the file is not the whole flight."""
    found: list[str] = []
    if counts.failure:
        found.append(f"writing failed ({counts.failure}); at least {counts.refused} messages are missing")
    for client, dropped in sorted(counts.dropped.items()):
        if dropped:
            found.append(f"{client} dropped {dropped} records, the recorder did not keep up")
    if counts.invalid:
        found.append(f"{counts.invalid} invalid records")
    if counts.crashed:
        found.append(
            f"{counts.crashed} clients ended without a goodbye, "
            f"{counts.unfinished_bytes} bytes of unfinished records lost"
        )
    return found
