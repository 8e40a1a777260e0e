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
    """A flight as rows, in the order of log time."""

    # metadata of the run; for a real flight barrier and pad of the configuration
    run: dict[str, str]
    namespace: str = ""  # first part of the controller's topics; empty without one
    steps: list[tuple[int, ControllerStepRow]] = field(default_factory=list)  # (log time in ns, row)
    timings: list[tuple[int, LoopTimingRow]] = field(default_factory=list)  # (log time in ns, row)
    truths: list[tuple[int, TrueStateRow]] = field(default_factory=list)  # (log time in ns, row)
    events: list[tuple[int, LogRow]] = field(default_factory=list)  # (log time in ns, row)
    problem: str = ""  # reason why the log is not whole; empty for a whole one

    @property
    def origin_ns(self) -> int:
        """Log time of the first step or true state."""
        return min(rows[0][0] for rows in (self.steps, self.truths) if rows)


def read(path: Path, member: str | None = None) -> Seen:
    """Read a log, whole or broken."""
    log = LogFile(path, member).single()
    seen = Seen(_shape(log) | log.metadata().get("run", {}))
    _fill(log, lambda _: seen)
    _finish(path, seen, log.why_broken)
    return seen


def read_fleet(path: Path) -> tuple[dict[str, Seen], list[tuple[int, LogRow]]]:
    """Read all members of a fleet, and the events of all with their whole names; as ``read``."""
    log = LogFile(path)
    found, events = {}, Seen({})
    for member in log.members:
        part = LogFile(path, member)
        found[member] = Seen(_shape(part) | part.metadata().get("run", {}))
    _fill(log, lambda topic: found.get(log.parts.owner(topic) or "", events))
    for seen in found.values():
        _finish(path, seen, log.why_broken)
    events.events.sort(key=lambda row: row[0])
    return found, events.events


_UNPACK: dict[str, tuple[str, Callable[[bytes], Any]]] = {
    CONTROLLER_STEP: ("steps", ControllerStepRow.unpack),
    LOOP_TIMING: ("timings", LoopTimingRow.unpack),
    TRUE_STATE: ("truths", TrueStateRow.unpack),
    LOG: ("events", LogRow.unpack),
}


def _fill(log: LogFile, seen_of: Callable[[str], Seen]) -> None:
    """Put the messages that are shown into what is seen of the flight with their topic."""
    for message in log.messages():
        if message.schema not in _UNPACK:
            continue
        name, unpack = _UNPACK[message.schema]
        seen = seen_of(message.topic)
        try:
            row = unpack(message.data)
        except ValueError as error:
            log.refuse(message, error)
            continue
        getattr(seen, name).append((message.log_time_ns, row))
        if message.schema == CONTROLLER_STEP:
            seen.namespace = message.topic.removesuffix("/controller/step").strip("/")


def _finish(path: Path, seen: Seen, problem: str) -> None:
    seen.problem = problem
    if not seen.steps and not seen.truths:
        raise LogError(f"{path} holds neither controller steps nor true states: there is no flight to show")
    for name, _ in _UNPACK.values():
        getattr(seen, name).sort(key=lambda row: row[0])


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
