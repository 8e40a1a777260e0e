"""Read a flight log into numpy arrays.

Three thousand steps with everything around them take a fraction of a second. A damaged log gives
what can be read of it, and says so.
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
    Event,
    Fleet,
    Flight,
    Steps,
    TargetOdometry,
    Timing,
    Truth,
    read_config,
)
from logs.reader.reader import LogError, LogFile, Message
from logs.schema.cdr import codec
from logs.schema.names import FLEET, NO_PAD
from logs.schema.rows import ControllerStepRow, FleetPairRow, LogRow, LoopTimingRow, TrueStateRow
from logs.schema.schemas import CONTROLLER_STEP, FLEET_PAIR, LOG, LOOP_TIMING, ODOMETRY, TRUE_STATE

__all__ = [
    "Event",
    "Flight",
    "Steps",
    "TargetOdometry",
    "Timing",
    "Truth",
    "load_fleet",
    "load_flight",
    "load_flights",
]

PAD_RADIUS_M = 0.10  # m, a Crazyflie's pad, where the log holds neither a run nor a configuration
TARGET_TOPIC_END = "/target/odom"  # below any namespace

_DTYPES = {"Floats": np.float64, "Ints": np.int64, "Bools": np.bool_}
_Columns = TypeVar("_Columns", Steps, Timing, Truth)


def load_flight(path: Path | str, member: str | None = None) -> Flight:
    """Read a log, whole or cut short.

    Args:
        path: of the log.
        member: of a fleet, whose flight it shall be; None in the log of one flight.

    Raises:
        LogError: not a log, or it holds neither controller steps nor true states, no such member, or a fleet
            where no member is named.
    """
    log = LogFile(path, member).single()
    by_kind: dict[str, list[Message]] = {}
    for message in log.messages():
        kind = _kind(message)
        if kind:
            by_kind.setdefault(kind, []).append(message)
    return _flight(log, by_kind, log.problem)


def load_fleet(path: Path | str) -> Fleet:
    """Read the flights of a fleet, in one pass."""
    whole = LogFile(path)
    if not whole.members:
        raise LogError(f"{path} is the log of one flight; that of a fleet has a metadata record {FLEET!r}")
    logs = {member: LogFile(path, member) for member in whole.members}
    views = {member: log.view for member, log in logs.items()}
    found: dict[str, dict[str, list[Message]]] = {member: {} for member in logs}
    pairs: dict[tuple[int, int], FleetPairRow] = {}
    said: list[Message] = []
    for message in whole.messages():
        if message.schema == LOG:
            said.append(message)
        if message.schema == FLEET_PAIR:
            try:
                pair = FleetPairRow.unpack(message.data)
            except ValueError as error:
                raise LogError(f"{path}: {message.topic}: {error}; recorded by another version?") from error
            pairs[pair.one, pair.other] = pair
        kind = _kind(message)
        for member, view in views.items() if kind else ():
            if view is not None and view.topic(message.topic) is not None:
                data = view.data(message.schema, message.data)
                if data is not None:
                    found[member].setdefault(kind, []).append(message._replace(data=data))
    problem, parts = whole.problem, whole.parts
    flights = {member: _flight(log, found[member], problem) for member, log in logs.items()}
    origin_ns = min(flight.origin_ns for flight in flights.values())
    said.sort(key=lambda message: message.log_time_ns)
    return Fleet(
        path=whole.path,
        flights=flights,
        pairs=pairs,
        ids=parts.ids,
        events=_events(said, origin_ns, []),  # what cannot be read is among the problems of the flights
        metadata={name: values for name, values in whole.metadata().items() if parts.split(name)[0] is None},
        attachments={a.name: a.data for a in whole.attachments() if parts.split(a.name)[0] is None},
    )


def load_flights(path: Path | str, member: str | None = None) -> list[Flight]:
    """Read all flights of a log: the one, those of all members of a fleet, or of one member."""
    if member is None and LogFile(path).members:
        return list(load_fleet(path).flights.values())
    return [load_flight(path, member)]


def _flight(log: LogFile, by_kind: Mapping[str, list[Message]], problem: str) -> Flight:
    path = log.path
    for messages in by_kind.values():
        messages.sort(key=lambda message: message.log_time_ns)
    problems = [f"the log is cut short or damaged ({problem})"] if problem else []
    spine = by_kind.get(CONTROLLER_STEP, []) + by_kind.get(TRUE_STATE, [])
    if not spine:
        found = ", ".join(sorted(by_kind)) or "nothing this stack writes"
        of = f", {log.member}" if log.member else ""
        raise LogError(
            f"{path}{of}: found {found}; a flight needs controller steps ({CONTROLLER_STEP}) or true states "
            f"({TRUE_STATE})" + (f"; {problems[0]}" if problems else "")
        )
    times_ns = [m.log_time_ns for m in spine]
    origin_ns = min(times_ns)
    attachments = {a.name: a.data for a in log.attachments()}
    run = log.metadata().get("run", {})
    config = _config(attachments, problems)
    return Flight(
        path=path,
        member=log.member,
        complete=log.complete,
        origin_ns=origin_ns,
        duration_s=(max(times_ns) - origin_ns) * 1e-9,
        steps=_columns(Steps, ControllerStepRow, by_kind.get(CONTROLLER_STEP, []), origin_ns, problems),
        timing=_columns(Timing, LoopTimingRow, by_kind.get(LOOP_TIMING, []), origin_ns, problems),
        truth=_columns(Truth, TrueStateRow, by_kind.get(TRUE_STATE, []), origin_ns, problems),
        target=_target(by_kind.get(ODOMETRY, []), origin_ns, problems),
        events=_events(by_kind.get(LOG, []), origin_ns, problems),
        metadata=log.metadata(),
        attachments=attachments,
        config=config,
        barrier=_barrier(run, config),
        velocity_max_m_s=_velocity_max(run, config),
        pad_radius_m=_pad_radius(run, config),
        pad_carries=run.get("pad") != NO_PAD,
        problems=tuple(problems),
    )


def _kind(message: Message) -> str:
    """Schema if the message is one we read, else empty."""
    if message.schema in (CONTROLLER_STEP, LOOP_TIMING, TRUE_STATE, LOG):
        return message.schema
    return ODOMETRY if message.schema == ODOMETRY and message.topic.endswith(TARGET_TOPIC_END) else ""


def _unpacked(
    schema: str, messages: Sequence[Message], unpack: Callable[[bytes], Any], problems: list[str]
) -> tuple[list[tuple[Any, ...]], Any]:
    """Values of the messages that can be read, field by field, and their log times in ns, (n,)."""
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
        problems.append(f"{len(refused)} messages of {schema} cannot be read; first: {refused[0]}")
    return list(zip(*rows, strict=True)), np.array(times_ns, dtype=np.int64)


def _columns(
    cls: type[_Columns], row: Any, messages: Sequence[Message], origin_ns: int, problems: list[str]
) -> _Columns | None:
    """Fill a dataclass of arrays whose field names are those of the row; ``None`` without messages."""
    if not messages:
        return None
    values, times_ns = _unpacked(messages[0].schema, messages, row.unpack, problems)
    by_name = dict(zip(row._fields, values, strict=True))
    wanted = {f.name: _DTYPES[str(f.type)] for f in fields(cls) if f.name != "t_s"}
    arrays: dict[str, Any] = {name: np.array(by_name[name]).astype(dtype) for name, dtype in wanted.items()}
    return cls(t_s=(times_ns - origin_ns) * 1e-9, **arrays)


def _target(messages: Sequence[Message], origin_ns: int, problems: list[str]) -> TargetOdometry | None:
    """Samples from outside: one that cannot be read is counted, never fatal."""
    if not messages:
        return None
    _, unpack = codec(ODOMETRY, frame_id=None)
    try:
        (headers, _, poses, twists), times_ns = _unpacked(ODOMETRY, messages, unpack, problems)
    except LogError as error:
        problems.append(f"target odometry: {error}")
        return None
    return TargetOdometry(
        t_s=(times_ns - origin_ns) * 1e-9,
        stamp_ns=np.array([stamp_ns for stamp_ns, _ in headers], dtype=np.int64),
        position_enu_m=np.array([position for (position, _), _ in poses]),
        velocity_child_m_s=np.array([linear for (linear, _), _ in twists]),
        frame_id=[frame for _, frame in headers],
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
    return tuple(events)


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
