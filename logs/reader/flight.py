"""Reads a flight log into numpy arrays.

Reading a flight of three thousand steps takes a fraction of a second. The readable part of a damaged log is
returned, with a description of the damage.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bridge.ros2.codec import Unpack
from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Intent
from logs.reader.flight_data import (
    ATTACHMENT,
    Event,
    Fleet,
    Flight,
    Floats,
    Ints,
    Span,
    Steps,
    TargetOdometry,
    Timing,
    Truth,
    number,
    read_config,
    sizes_of,
)
from logs.reader.reader import ROSOUT, EmptyLogError, LogError, LogFile, Message
from logs.schema import NO_PAD
from logs.schema.rows import (
    ControllerStepRow,
    FleetPairRow,
    LogRow,
    LoopTimingRow,
    MemberStatusRow,
    TrueStateRow,
)
from logs.schema.schemas import (
    CONTROLLER_STEP,
    FLEET_PAIR,
    LOG,
    LOOP_TIMING,
    MEMBER_STATUS,
    ODOMETRY,
    TRUE_STATE,
    codec,
)

TARGET_TOPIC_END = "/target/odom"  # end of the topic in any namespace
_OF_A_FLIGHT = (CONTROLLER_STEP, LOOP_TIMING, TRUE_STATE, MEMBER_STATUS)

_DTYPES = {"Floats": np.float64, "Ints": np.int64, "Bools": np.bool_}
_Columns = TypeVar("_Columns", Steps, Timing, Truth)
_Data = TypeVar("_Data")


def load_flight(path: Path | str, member: str | None = None) -> Flight:
    """Read a log, complete or truncated.

    Args:
        path: log file.
        member: name of the vehicle whose flight is read; None if the log has one flight.

    Raises:
        LogError: the file is no log, has neither controller steps nor true states, or has no such member; or
        it is the log of a fleet and no member is given.
    """
    return next(iter(_read(LogFile(path, member).single()).flights.values()))


def load_fleet(path: Path | str) -> Fleet:
    """Read the flights of all members in one pass over the log."""
    return _read(LogFile(path))


def _read(log: LogFile) -> Fleet:
    log.need(CONTROLLER_STEP, TRUE_STATE, FLEET_PAIR)
    found: dict[str, dict[str, list[Message]]] = {name: defaultdict(list) for name in log.members}
    pairs: dict[tuple[int, int], FleetPairRow] = {}
    said: list[Message] = []  # events of all members and of shared processes
    for message in log.messages():
        topic, schema = message.topic, message.schema
        if schema == FLEET_PAIR:
            try:
                pair = FleetPairRow.unpack(message.data)
            except ValueError as error:
                raise LogError(f"{log.path}: {topic}: {error}") from error
            pairs[pair.one, pair.other] = pair
        elif schema in _OF_A_FLIGHT or topic == ROSOUT or topic.endswith(TARGET_TOPIC_END):
            for name in log.owners(message):
                found[name][schema].append(message)
            if topic == ROSOUT:
                said.append(message)
    flights = {name: _flight(log.part(name), found[name]) for name in log.members}
    origin_ns = min(flight.origin_ns for flight in flights.values())
    return Fleet(
        path=log.path,
        flights=flights,
        pairs=pairs,
        ids=log.ids,
        # the flights already report unreadable events as problems
        events=_events(said, origin_ns, [], log),
        metadata={key: values for key, values in log.metadata().items() if not log.owner(key)},
        attachments={each.name: each.data for each in log.attachments() if not log.owner(each.name)},
    )


def _flight(log: LogFile, by_schema: Mapping[str, list[Message]]) -> Flight:
    for messages in by_schema.values():
        messages.sort(key=lambda message: message.log_time_ns)
    damage = [f"the log is cut short or damaged ({log.problem})"] if log.problem else []
    times_ns = [m.log_time_ns for kind in (CONTROLLER_STEP, TRUE_STATE) for m in by_schema.get(kind, ())]
    origin_ns = min(times_ns, default=0)
    metadata, attachments = log.metadata(), {a.name: a.data for a in log.attachments()}
    config, problems = _config(attachments)
    run = metadata.get("run", {})

    def read(schema: str, convert: Callable[[Sequence[Any], Floats], _Data], unpack: Unpack) -> _Data | None:
        rows, t_s = _unpacked(by_schema.get(schema, []), unpack, origin_ns, damage)
        return convert(rows, t_s) if rows else None

    steps = read(CONTROLLER_STEP, partial(columns, Steps), ControllerStepRow.unpack)
    truth = read(TRUE_STATE, partial(columns, Truth), TrueStateRow.unpack)
    if steps is None and truth is None:
        found = ", ".join(sorted(by_schema)) or "nothing this stack writes"
        raise (LogError if damage else EmptyLogError)(
            f"{log.path}, {log.member}: found {found}; a flight needs controller steps "
            f"({CONTROLLER_STEP}) or true states ({TRUE_STATE})" + "".join(f"; {each}" for each in damage)
        )
    return Flight(
        path=log.path,
        member=log.member or "",
        complete=log.complete,
        origin_ns=origin_ns,
        duration_s=(max(times_ns) - origin_ns) * 1e-9,
        steps=steps,
        timing=read(LOOP_TIMING, partial(columns, Timing), LoopTimingRow.unpack),
        truth=truth,
        target=read(ODOMETRY, _target, codec(ODOMETRY, frame_id=None)[1]),
        spans=read(MEMBER_STATUS, partial(_spans, log.ids), _status) or (),
        events=_events(by_schema.get(LOG, []), origin_ns, damage, log),
        metadata=metadata,
        attachments=attachments,
        config=config,
        barrier=_barrier(run, config),
        pad_radius_m=sizes_of(config, run).pad_radius_m,
        pad_carries=run.get("pad") != NO_PAD,
        problems=(*damage, *problems),
    )


def _unpacked(
    messages: Sequence[Message], unpack: Unpack, origin_ns: int, damage: list[str]
) -> tuple[list[Any], Floats]:
    """Return the decoded rows and their times since ``origin_ns``, s, (n,); report undecodable messages."""
    rows, times_ns, refused = [], [], []
    for message in messages:
        try:
            rows.append(unpack(message.data))
            times_ns.append(message.log_time_ns)
        except ValueError as error:
            refused.append(str(error))
    if refused:
        damage.append(f"{len(refused)} messages of {messages[0].schema} cannot be read; first: {refused[0]}")
    return rows, since(np.array(times_ns, dtype=np.int64), origin_ns)


def columns(cls: type[_Columns], rows: Sequence[Any], t_s: Floats) -> _Columns:
    """Convert rows of a log into arrays; ``t_s`` has the times of the n rows, s."""
    by_name = dict(zip(rows[0]._fields, zip(*rows, strict=True), strict=True))
    wanted = {f.name: _DTYPES[str(f.type)] for f in fields(cls) if f.name != "t_s"}
    arrays: dict[str, Any] = {name: np.array(by_name[name]).astype(dtype) for name, dtype in wanted.items()}
    return cls(t_s=t_s, **arrays)


def since(times_ns: Ints, origin_ns: int) -> Floats:
    return np.asarray((times_ns - origin_ns) * 1e-9, dtype=np.float64)


def _target(rows: Sequence[Any], t_s: Floats) -> TargetOdometry:
    headers, _, poses, twists = zip(*rows, strict=True)
    return TargetOdometry(
        t_s=t_s,
        stamp_ns=np.array([stamp_ns for stamp_ns, _ in headers], dtype=np.int64),
        position_enu_m=np.array([position for (position, _), _ in poses]),
        velocity_child_m_s=np.array([linear for (linear, _), _ in twists]),
    )


def _status(data: bytes) -> tuple[Intent, bytes]:
    """Return intent and ``yields_to`` of a status message. Raises ValueError: it cannot be decoded."""
    row = MemberStatusRow.unpack(data)
    return Intent(row.intent), row.yields_to


def _spans(names: Mapping[int, str], told: Sequence[tuple[Intent, bytes]], t_s: Floats) -> tuple[Span, ...]:
    runs = [(key, next(run)[0]) for key, run in groupby(zip(t_s.tolist(), told, strict=True), itemgetter(1))]
    ends_s = [*(begin_s for _, begin_s in runs[1:]), float(t_s[-1])]
    return tuple(
        Span(begin_s, end_s, intent, tuple(names.get(n, f"vehicle {n}") for n in yields_to))
        for ((intent, yields_to), begin_s), end_s in zip(runs, ends_s, strict=True)
    )


def _events(
    messages: Sequence[Message], origin_ns: int, damage: list[str], log: LogFile
) -> tuple[Event, ...]:
    """Return the events in order of time; in the part of a member, sources lack the member's name."""
    in_order = sorted(messages, key=lambda message: message.log_time_ns)
    rows, times_s = _unpacked(in_order, LogRow.unpack, origin_ns, damage)
    return tuple(
        Event(t_s, row.level, log.plain(row.name, "."), row.msg)
        for t_s, row in zip(times_s.tolist(), rows, strict=True)
    )


def _config(attachments: dict[str, bytes]) -> tuple[FlightConfig | None, tuple[str, ...]]:
    """Return the configuration in the log, or None with the reason why it cannot be read."""
    data = attachments.get(ATTACHMENT)
    if data is None:
        return None, ()
    try:
        return read_config(data), ()
    except ConfigError as error:
        return None, (f"{ATTACHMENT} in the log: {error}",)


def _barrier(run: Mapping[str, str], config: FlightConfig | None) -> Barrier | None:
    """Return the barrier for the verdict: of the scenario's ``[judge]``, or else of the configuration."""
    alpha_1_m, beta_m = number(run, "judge_alpha_1_m"), number(run, "judge_beta_m")
    if alpha_1_m is not None and beta_m is not None:
        return Barrier(alpha_1_m, beta_m)
    return config.barrier if config is not None else None
