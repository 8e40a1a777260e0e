"""Reads a flight log into numpy arrays.

Reading three thousand steps with all other messages takes a fraction of a second. Of a damaged log the
readable part is returned, with a description of the damage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
    PAD_RADIUS_M,
    Event,
    Fleet,
    Flight,
    Floats,
    Ints,
    Steps,
    TargetOdometry,
    Timing,
    Truth,
    read_config,
)
from logs.reader.reader import LogError, LogFile, Message
from logs.schema.names import NO_PAD
from logs.schema.rows import ControllerStepRow, FleetPairRow, LogRow, LoopTimingRow, TrueStateRow
from logs.schema.schemas import CONTROLLER_STEP, FLEET_PAIR, LOG, LOOP_TIMING, ODOMETRY, TRUE_STATE, codec

__all__ = [
    "Event",
    "Flight",
    "Steps",
    "TargetOdometry",
    "Timing",
    "Truth",
    "load_fleet",
    "load_flight",
]

TARGET_TOPIC_END = "/target/odom"  # end of the topic in any namespace

_DTYPES = {"Floats": np.float64, "Ints": np.int64, "Bools": np.bool_}
_Columns = TypeVar("_Columns", Steps, Timing, Truth)


def load_flight(path: Path | str, member: str | None = None) -> Flight:
    """Read a log, complete or truncated.

    Args:
        path: log file.
        member: name of the fleet member to read; None for the log of one flight.

    Raises:
        LogError: not a log, or it holds neither controller steps nor true states, no such member, or a fleet
        without a member given.
    """
    return _read(LogFile(path, member).single()).flights[""]


def load_fleet(path: Path | str, member: str | None = None) -> Fleet:
    """Read all flights of a log in one pass; the name of a single flight, or of a member alone, is empty."""
    return _read(LogFile(path, member))


def _read(whole: LogFile) -> Fleet:
    whole.need(CONTROLLER_STEP, TRUE_STATE, FLEET_PAIR)
    path = whole.path
    logs = {name: whole.part(name) for name in whole.members} or {"": whole}
    found: dict[str, dict[str, list[Message]]] = {name: {} for name in logs}
    pairs: dict[tuple[int, int], FleetPairRow] = {}
    for message in whole.messages():
        if message.schema == FLEET_PAIR:
            try:
                pair = FleetPairRow.unpack(message.data)
            except ValueError as error:
                raise LogError(f"{path}: {message.topic}: {error}") from error
            pairs[pair.one, pair.other] = pair
        kind = _kind(message)
        for name, log in logs.items() if kind else ():
            seen = message if log is whole else log.part_of(message)
            if seen is not None:
                found[name].setdefault(kind, []).append(seen)
        if kind == LOG and "" not in logs:
            found.setdefault("", {}).setdefault(kind, []).append(message)
    problem, parts = whole.problem, whole.parts
    flights = {name: _flight(log, found[name], problem) for name, log in logs.items()}
    origin_ns = min(flight.origin_ns for flight in flights.values())
    said = sorted(found.get("", {}).get(LOG, []), key=lambda message: message.log_time_ns)
    return Fleet(
        path=whole.path,
        flights=flights,
        pairs=pairs,
        ids=parts.ids,
        events=_events(said, origin_ns, []),  # unreadable events are among the problems of the flights
        metadata={name: values for name, values in whole.metadata().items() if parts.split(name)[0] is None},
        attachments={a.name: a.data for a in whole.attachments() if parts.split(a.name)[0] is None},
    )


def _flight(log: LogFile, by_kind: Mapping[str, list[Message]], problem: str) -> Flight:
    path = log.path
    for messages in by_kind.values():
        messages.sort(key=lambda message: message.log_time_ns)
    damage = [f"the log is cut short or damaged ({problem})"] if problem else []
    spine = by_kind.get(CONTROLLER_STEP, []) + by_kind.get(TRUE_STATE, [])
    if not spine:
        found = ", ".join(sorted(by_kind)) or "nothing this stack writes"
        of = f", {log.member}" if log.member else ""
        raise LogError(
            f"{path}{of}: found {found}; a flight needs controller steps ({CONTROLLER_STEP}) or true states "
            f"({TRUE_STATE})" + (f"; {damage[0]}" if damage else "")
        )
    times_ns = [m.log_time_ns for m in spine]
    origin_ns = min(times_ns)
    attachments = {a.name: a.data for a in log.attachments()}
    run = log.metadata().get("run", {})
    config, problems = _config(attachments)
    steps = _columns(Steps, ControllerStepRow, by_kind.get(CONTROLLER_STEP, []), origin_ns, damage)
    timing = _columns(Timing, LoopTimingRow, by_kind.get(LOOP_TIMING, []), origin_ns, damage)
    truth = _columns(Truth, TrueStateRow, by_kind.get(TRUE_STATE, []), origin_ns, damage)
    target = _target(by_kind.get(ODOMETRY, []), origin_ns, damage)
    events = _events(by_kind.get(LOG, []), origin_ns, damage)
    return Flight(
        path=path,
        member=log.member,
        complete=log.complete,
        origin_ns=origin_ns,
        duration_s=(max(times_ns) - origin_ns) * 1e-9,
        steps=steps,
        timing=timing,
        truth=truth,
        target=target,
        events=events,
        metadata=log.metadata(),
        attachments=attachments,
        config=config,
        barrier=_barrier(run, config),
        velocity_max_m_s=_velocity_max(run, config),
        pad_radius_m=_pad_radius(run, config),
        pad_carries=run.get("pad") != NO_PAD,
        damage=tuple(damage),
        problems=(*damage, *problems),
    )


def _kind(message: Message) -> str:
    """Return the schema if this reader uses the message, else empty."""
    if message.schema in (CONTROLLER_STEP, LOOP_TIMING, TRUE_STATE, LOG):
        return message.schema
    return ODOMETRY if message.schema == ODOMETRY and message.topic.endswith(TARGET_TOPIC_END) else ""


def _unpacked(
    schema: str, messages: Sequence[Message], unpack: Callable[[bytes], Any], damage: list[str]
) -> tuple[list[Any], Ints]:
    """Return the readable messages, and their log times in ns, (n,)."""
    rows, times_ns, refused = [], [], []
    for message in messages:
        try:
            rows.append(unpack(message.data))
            times_ns.append(message.log_time_ns)
        except ValueError as error:
            refused.append(str(error))
    if not rows:
        raise LogError(refused[0])
    if refused:
        damage.append(f"{len(refused)} messages of {schema} cannot be read; first: {refused[0]}")
    return rows, np.array(times_ns, dtype=np.int64)


def _columns(
    cls: type[_Columns], row: Any, messages: Sequence[Message], origin_ns: int, damage: list[str]
) -> _Columns | None:
    if not messages:
        return None
    try:
        rows, times_ns = _unpacked(messages[0].schema, messages, row.unpack, damage)
    except LogError as error:
        if cls is not Timing:
            raise
        damage.append(f"loop timing: {error}")
        return None
    return columns(cls, rows, since(times_ns, origin_ns))


def columns(cls: type[_Columns], rows: Sequence[Any], t_s: Floats) -> _Columns:
    """Convert rows of a log into arrays; ``t_s`` has the times of the n rows, s."""
    by_name = dict(zip(rows[0]._fields, zip(*rows, strict=True), strict=True))
    wanted = {f.name: _DTYPES[str(f.type)] for f in fields(cls) if f.name != "t_s"}
    arrays: dict[str, Any] = {name: np.array(by_name[name]).astype(dtype) for name, dtype in wanted.items()}
    return cls(t_s=t_s, **arrays)


def since(times_ns: Ints, origin_ns: int) -> Floats:
    return np.asarray((times_ns - origin_ns) * 1e-9, dtype=np.float64)


def _target(messages: Sequence[Message], origin_ns: int, damage: list[str]) -> TargetOdometry | None:
    """Return the samples of external senders; unreadable ones are counted and skipped."""
    if not messages:
        return None
    _, unpack = codec(ODOMETRY, frame_id=None)
    try:
        rows, times_ns = _unpacked(ODOMETRY, messages, unpack, damage)
    except LogError as error:
        damage.append(f"target odometry: {error}")
        return None
    headers, _, poses, twists = zip(*rows, strict=True)
    return TargetOdometry(
        t_s=since(times_ns, origin_ns),
        stamp_ns=np.array([stamp_ns for stamp_ns, _ in headers], dtype=np.int64),
        position_enu_m=np.array([position for (position, _), _ in poses]),
        velocity_child_m_s=np.array([linear for (linear, _), _ in twists]),
        frame_id=[frame for _, frame in headers],
    )


def _events(messages: Sequence[Message], origin_ns: int, damage: list[str]) -> tuple[Event, ...]:
    events: list[Event] = []
    for message in messages:
        try:
            row = LogRow.unpack(message.data)
        except ValueError as error:
            damage.append(f"event: {error}")
            continue
        t_s = (message.log_time_ns - origin_ns) * 1e-9
        events.append(Event(t_s, row.level, row.name, row.msg))
    return tuple(events)


def _config(attachments: dict[str, bytes]) -> tuple[FlightConfig | None, tuple[str, ...]]:
    """Return the flight's configuration if the log holds it, and the reason why it cannot be read."""
    data = attachments.get(ATTACHMENT)
    if data is None:
        return None, ()
    try:
        return read_config(data), ()
    except ConfigError as error:
        return None, (f"{ATTACHMENT} in the log: {error}",)


def _barrier(run: dict[str, str], config: FlightConfig | None) -> Barrier | None:
    """Return the barrier of the scenario's verdict, else the controller's barrier."""
    for alpha, beta in (("judge_alpha_1_m", "judge_beta_m"), ("barrier_alpha_1_m", "barrier_beta_m")):
        alpha_1_m, beta_m = _number(run, alpha), _number(run, beta)
        if alpha_1_m is not None and beta_m is not None:
            return Barrier(alpha_1_m, beta_m)
    return config.barrier.build() if config is not None else None


def _pad_radius(run: dict[str, str], config: FlightConfig | None) -> float:
    """Return the pad radius of the scenario, else of the configuration, which real flights always have."""
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
