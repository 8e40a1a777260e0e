"""What signing must remember from one run to the next, in a small file beside the key.

Without it a clock that went back, or a restart alone, would let recorded frames pass a second time.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

Stream = tuple[int, int, int]  # link id, system id, component id

STREAMS_MAX = 64  # more senders than any link of this stack has; only holders of the key can fill it
TIMESTAMP_MAX = 2**48 - 1
_READ_MAX = 65536  # bytes; 64 streams need 3000


@dataclass(slots=True)
class SigningState:
    """Times in units of 10 us since 2015-01-01 UTC, as MAVLink 2 signing counts them.

    Attributes:
        clock: our clock when this was written.
        sent: timestamp of the last frame that we signed.
        streams: timestamp of the last frame accepted of each stream; the longest silent comes first.
    """

    clock: int = 0
    sent: int = 0
    streams: dict[Stream, int] = field(default_factory=dict)


def load_state(path: Path) -> SigningState:
    """Read a state; an empty one when there is no file yet.

    Raises:
        ValueError: the file holds something else.
        OSError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_READ_MAX)
    except FileNotFoundError:
        return SigningState()
    try:
        table = json.loads(data)
        streams = {_stream(*row[:3]): _timestamp(row[3]) for row in table["streams"]}
        state = SigningState(_timestamp(table["clock"]), _timestamp(table["sent"]), streams)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise ValueError(
            f"signing state {path} cannot be read ({error}): delete it, and frames of the minute before "
            "could be replayed once"
        ) from error
    if len(streams) > STREAMS_MAX:
        raise ValueError(f"signing state {path} has {len(streams)} streams, allowed are {STREAMS_MAX}")
    return state


def save_state(path: Path, state: SigningState) -> None:
    """Write a state, whole or not at all; readable by its owner alone.

    Raises:
        OSError: it cannot be written.
    """
    rows = [[*stream, timestamp] for stream, timestamp in state.streams.items()]
    text = json.dumps({"clock": state.clock, "sent": state.sent, "streams": rows})
    new = path.with_name(f"{path.name}.{os.getpid()}")
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
    try:
        with os.fdopen(descriptor, "w") as file:
            file.write(text)
        new.replace(path)
    except OSError:
        new.unlink(missing_ok=True)
        raise


def _timestamp(value: object) -> int:
    if type(value) is not int or not 0 <= value <= TIMESTAMP_MAX:
        raise ValueError(f"timestamp {value!r}")
    return value


def _stream(link: object, system: object, component: object) -> Stream:
    numbers = (link, system, component)
    if any(type(n) is not int or not 0 <= n <= 255 for n in numbers):
        raise ValueError(f"stream {numbers!r}")
    return numbers  # type: ignore[return-value]
