"""What a 3-D viewer shows of a flight, read from its log into arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flightstack.common.strict_toml import ConfigError
from logs.reader.flight_data import ATTACHMENT, read_config, shape
from logs.reader.reader import LogError, LogFile
from logs.schema.rows import ControllerStepRow, LogRow, LoopTimingRow, TrueStateRow
from logs.schema.schemas import CONTROLLER_STEP, LOG, LOOP_TIMING, TRUE_STATE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass
class Seen:
    """A flight as rows, in the order of log time.

    Attributes:
        run: metadata of the run; of a real flight, which has none, barrier and pad of the configuration.
        namespace: first part of the topics of the controller, "" if it had none.
        steps, timings, truths, events: (log time in ns, row).
        problem: why the log is not whole; empty for one that is.
    """

    run: dict[str, str]
    namespace: str = ""
    steps: list[tuple[int, ControllerStepRow]] = field(default_factory=list)
    timings: list[tuple[int, LoopTimingRow]] = field(default_factory=list)
    truths: list[tuple[int, TrueStateRow]] = field(default_factory=list)
    events: list[tuple[int, LogRow]] = field(default_factory=list)
    problem: str = ""

    @property
    def origin_ns(self) -> int:
        """Log time of the first step or true state."""
        return min(rows[0][0] for rows in (self.steps, self.truths) if rows)


def read(path: Path) -> Seen:
    """Read a log, whole or broken.

    Raises:
        LogError: Not a log, without controller steps and true states, or a message that is not ours.
    """
    log = LogFile(path)
    seen = Seen(_shape(log) | log.metadata().get("run", {}))
    kinds: dict[str, tuple[list[tuple[int, Any]], Callable[[bytes], Any]]] = {
        CONTROLLER_STEP: (seen.steps, ControllerStepRow.unpack),
        LOOP_TIMING: (seen.timings, LoopTimingRow.unpack),
        TRUE_STATE: (seen.truths, TrueStateRow.unpack),
        LOG: (seen.events, LogRow.unpack),
    }
    for message in log.messages():
        if message.schema not in kinds:
            continue
        rows, unpack = kinds[message.schema]
        try:
            rows.append((message.log_time_ns, unpack(message.data)))
        except ValueError as error:
            raise LogError(f"{path}: {message.topic}: {error}; recorded by another version?") from error
        if message.schema == CONTROLLER_STEP:
            seen.namespace = message.topic.removesuffix("/controller/step").strip("/")
    seen.problem = log.why_broken
    if not seen.steps and not seen.truths:
        raise LogError(f"{path} holds neither controller steps nor true states: there is no flight to show")
    for rows, _ in kinds.values():
        rows.sort(key=lambda row: row[0])
    return seen


def _shape(log: LogFile) -> dict[str, str]:
    """Barrier and pad by the configuration in the log, empty where there is none of this version."""
    data = log.attachment(ATTACHMENT)
    try:
        return {} if data is None else shape(read_config(data))
    except ConfigError:
        return {}


def times(rows: Sequence[tuple[int, object]]) -> Ints:
    """Log times in ns, (n,)."""
    return np.array([time_ns for time_ns, _ in rows], dtype=np.int64)


def column(rows: Sequence[tuple[int, object]], name: str) -> Floats:
    """One field of all rows, (n,) or (n, 3)."""
    return np.array([getattr(row, name) for _, row in rows], dtype=np.float64)


def every(rows: Sequence[tuple[int, object]], period_ns: int) -> list[int]:
    """Indices of the first row of each period: what a screen can show is less than what is recorded."""
    kept, slot = [], None
    for index, (time_ns, _) in enumerate(rows):
        if slot != (slot := time_ns // period_ns):
            kept.append(index)
    return kept
