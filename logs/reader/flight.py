"""Read a flight log into numpy arrays.

Three thousand steps with everything around them take a fraction of a second. A log that was cut short gives
what came before the cut, and says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Vec3
from logs.reader.flight_data import (
    ATTACHMENT,
    Event,
    Flight,
    Steps,
    TargetOdometry,
    Timing,
    Truth,
    read_config,
)
from logs.reader.flight_decode import columns
from logs.reader.reader import LogError, LogFile, Message
from logs.schema.rows import LogRow
from logs.schema.schemas import CONTROLLER_STEP, LOG, LOOP_TIMING, ODOMETRY, TRUE_STATE

__all__ = ["Event", "Flight", "Steps", "TargetOdometry", "Timing", "Truth", "load_flight"]

PAD_RADIUS_M = 0.10  # m, a Crazyflie's pad, where the log holds neither a run nor a configuration
TARGET_TOPIC_END = "/target/odom"  # below any namespace

_DTYPES = {"Floats": np.float64, "Ints": np.int64, "Bools": np.bool_}
_NS = 1_000_000_000  # nanoseconds in a second
_Rows = TypeVar("_Rows", Steps, Timing, Truth)


def load_flight(path: Path | str) -> Flight:
    """Read a log, whole or cut short.

    Raises:
        LogError: not a log, or it holds neither controller steps nor true states.
    """
    log = LogFile(path)
    by_kind: dict[str, list[Message]] = {}
    for message in log.messages():
        kind = _kind(message)
        if kind:
            by_kind.setdefault(kind, []).append(message)
    for messages in by_kind.values():
        messages.sort(key=lambda message: message.log_time_ns)
    problems = [] if not log.problem else [f"the log is cut short or damaged ({log.problem})"]
    spine = by_kind.get(CONTROLLER_STEP, []) + by_kind.get(TRUE_STATE, [])
    if not spine:
        found = ", ".join(sorted(by_kind)) or "nothing this stack writes"
        raise LogError(
            f"{path}: found {found}; a flight needs controller steps ({CONTROLLER_STEP}) or true states "
            f"({TRUE_STATE})" + (f"; {problems[0]}" if problems else "")
        )
    times_ns = [m.log_time_ns for m in spine]
    origin_ns = min(times_ns)
    if not log.complete and not problems:
        problems.append("the recorder did not close the log; what follows its last flush is lost")
    attachments = {a.name: a.data for a in log.attachments()}
    run = log.metadata().get("run", {})
    config = _config(attachments, problems)
    return Flight(
        path=Path(path),
        complete=log.complete,
        origin_ns=origin_ns,
        duration_s=(max(times_ns) - origin_ns) * 1e-9,
        steps=_rows(Steps, by_kind.get(CONTROLLER_STEP, []), origin_ns, problems),
        timing=_rows(Timing, by_kind.get(LOOP_TIMING, []), origin_ns, problems),
        truth=_rows(Truth, by_kind.get(TRUE_STATE, []), origin_ns, problems),
        target=_target(by_kind.get(ODOMETRY, []), origin_ns, problems),
        events=_events(by_kind.get(LOG, []), origin_ns, problems),
        metadata=log.metadata(),
        attachments=attachments,
        config=config,
        barrier=_barrier(run, config),
        velocity_max_m_s=_velocity_max(run, config),
        pad_radius_m=_pad_radius(run, config),
        problems=tuple(problems),
    )


def _kind(message: Message) -> str:
    """Schema if the message is one we read, else empty."""
    if message.schema in (CONTROLLER_STEP, LOOP_TIMING, TRUE_STATE, LOG):
        return message.schema
    return ODOMETRY if message.schema == ODOMETRY and message.topic.endswith(TARGET_TOPIC_END) else ""


def _rows(cls: type[_Rows], messages: Sequence[Message], origin_ns: int, problems: list[str]) -> _Rows | None:
    """Fill a dataclass of arrays whose field names are those of the message; ``None`` without messages."""
    if not messages:
        return None
    wanted = {f.name: _DTYPES[str(f.type)] for f in fields(cls) if f.name != "t_s"}
    found = columns(messages[0].schema, [m.data for m in messages], wanted)
    _complain(found.problems, messages[0].schema, problems)
    values: dict[str, Any] = {name: found.numbers[name].astype(dtype) for name, dtype in wanted.items()}
    return cls(t_s=_seconds(messages, found.rows, origin_ns), **values)


def _target(messages: Sequence[Message], origin_ns: int, problems: list[str]) -> TargetOdometry | None:
    """Samples from outside: one that cannot be read is counted, never fatal."""
    wanted = ("header.stamp.sec", "header.stamp.nanosec", "pose.pose.position", "twist.twist.linear")
    try:
        found = columns(ODOMETRY, [m.data for m in messages], wanted)
    except LogError as error:
        if messages:
            problems.append(f"target odometry: {error}")
        return None
    _complain(found.problems, ODOMETRY, problems)
    sec, nanosec, position, velocity = (found.numbers[name] for name in wanted)
    return TargetOdometry(
        t_s=_seconds(messages, found.rows, origin_ns),
        stamp_ns=sec.astype(np.int64) * _NS + nanosec.astype(np.int64),
        position_enu_m=position,
        velocity_child_m_s=velocity,
        frame_id=found.texts["header.frame_id"],
    )


def _events(messages: Sequence[Message], origin_ns: int, problems: list[str]) -> tuple[Event, ...]:
    events: list[Event] = []
    for message in messages:
        try:
            row = LogRow.unpack(message.data)
        except ValueError as error:
            problems.append(f"event: {error}")
            continue
        t_s = (message.log_time_ns - origin_ns) * 1e-9
        events.append(Event(t_s, row.level, row.name, row.msg))
    return tuple(sorted(events, key=lambda event: event.t_s))


def _seconds(messages: Sequence[Message], rows: Any, origin_ns: int) -> Any:
    times_ns = np.array([m.log_time_ns for m in messages], dtype=np.int64)[rows]
    return (times_ns - origin_ns) * 1e-9


def _complain(found: Sequence[str], schema: str, problems: list[str]) -> None:
    if found:
        problems.append(f"{len(found)} messages of {schema} cannot be read; first: {found[0]}")


def _config(attachments: dict[str, bytes], problems: list[str]) -> FlightConfig | None:
    """Configuration the onboard process flew with, if the log holds it."""
    data = attachments.get(ATTACHMENT)
    if data is None:
        return None
    try:
        return read_config(data)
    except ConfigError as error:
        problems.append(f"{ATTACHMENT} in the log: {error}")
        return None


def _barrier(run: dict[str, str], config: FlightConfig | None) -> Barrier | None:
    """Barrier of the scenario's judge, else the one the controller flew with."""
    for alpha, beta in (("judge_alpha_1_m", "judge_beta_m"), ("barrier_alpha_1_m", "barrier_beta_m")):
        alpha_1_m, beta_m = _number(run, alpha), _number(run, beta)
        if alpha_1_m is not None and beta_m is not None:
            return Barrier(alpha_1_m, beta_m)
    return config.barrier.build() if config is not None else None


def _pad_radius(run: dict[str, str], config: FlightConfig | None) -> float:
    """Of the scenario, else of the configuration, which is all that a real flight has."""
    told_m = _number(run, "pad_radius_m")
    if told_m is not None:
        return told_m
    return config.touchdown.pad_radius_m if config is not None else PAD_RADIUS_M


def _velocity_max(run: dict[str, str], config: FlightConfig | None) -> Vec3 | None:
    x, y, z = (_number(run, f"velocity_max_{axis}_m_s") for axis in "xyz")
    if x is not None and y is not None and z is not None:
        return (x, y, z)
    return config.limits.velocity_max_m_s if config is not None else None


def _number(run: dict[str, str], key: str) -> float | None:
    try:
        return float(run[key])
    except (KeyError, ValueError):
        return None
