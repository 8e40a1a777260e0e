"""Messages between the members of a fleet, read from its log: waiting times and lost messages.

Times are seconds since the origin of the fleet (``Fleet.origin_ns``), by the log time of the tick.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import groupby, permutations

import numpy as np

from flightstack.core.types import Intent
from logs.reader.flight_data import Fleet, Floats
from logs.reader.reader import LogFile
from logs.schema.controller_rows import unpack_neighbours
from logs.schema.rows import MemberStatusRow
from logs.schema.schemas import CONTROLLER_NEIGHBOURS, MEMBER_STATUS

AGE_MAX_S = 0.5  # maximum message age by default, s
_Sent = tuple[float, Intent, tuple[str, ...]]  # time, s; intent; members to which the sender gives way


@dataclass(frozen=True, slots=True)
class Span:
    """An interval in which all messages of a member had the same content."""

    begin_s: float  # time of the first message, s
    end_s: float  # time of the first message with other content, or of the last message, s
    intent: Intent  # intent that the member announced
    gives_way_to: tuple[str, ...]  # names of the members to which this member gives way

    @property
    def waits(self) -> bool:
        """Whether the member flew and gave way to a neighbour."""
        return self.intent is Intent.WAITING and bool(self.gives_way_to)


@dataclass(frozen=True, slots=True)
class Link:
    """Statistics of the messages from one member to another."""

    sender: str  # name of the sending member
    receiver: str  # name of the receiving member
    sent: int  # number of messages sent before the receiver's last tick
    # number of messages that the receiver used; the other messages were lost or replaced by newer ones
    used: int
    late_max_s: float | None  # maximum message age on arrival, s; None: none arrived
    # longest time between two messages, or from the last one to the end, while the sender flew, s
    gap_max_s: float
    # intervals (begin, end), s, in which the newest message was older than the receiver accepts
    silent: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class FleetMessages:
    """Messages that the members of a fleet sent and received."""

    spans: dict[str, tuple[Span, ...]]  # spans by member, in time order
    links: tuple[Link, ...]  # one link per ordered pair of members
    problems: tuple[str, ...]  # descriptions of unreadable messages


def load_messages(fleet: Fleet) -> FleetMessages:
    """Read the messages between members, in one pass over the log."""
    log, names = LogFile(fleet.path), fleet.ids
    sent: dict[str, list[_Sent]] = defaultdict(list)
    ticks: dict[str, list[float]] = defaultdict(list)
    received: dict[tuple[str, str], list[tuple[float, float, Intent]]] = defaultdict(list)
    refused: list[str] = []
    for message in log.messages():
        member = log.parts.owner(message.topic)
        if member is None or message.schema not in (CONTROLLER_NEIGHBOURS, MEMBER_STATUS):
            continue
        t_s = (message.log_time_ns - fleet.origin_ns) * 1e-9
        try:
            if message.schema == MEMBER_STATUS:
                row = MemberStatusRow.unpack(message.data)
                others = tuple(names.get(number, f"vehicle {number}") for number in row.yields_to)
                sent[member].append((t_s, Intent(row.intent), others))
                continue
            ticks[member].append(t_s)
            for word in unpack_neighbours(message.data):
                sender = names.get(word.id, f"vehicle {word.id}")
                received[sender, member].append((t_s, word.arrival_s - word.stamp_s, word.intent))
        except ValueError as error:
            refused.append(f"{message.topic}: {error}")
    problems = (
        [f"{len(refused)} messages between members cannot be read; first: {refused[0]}"] if refused else []
    )
    links = []
    for sender, receiver in permutations(fleet.flights, 2):
        if ticks[receiver]:
            sent_s = [t_s for t_s, *_ in sent[sender]]
            age_max_s = _age_max_s(fleet, receiver)
            links.append(
                _link(sender, receiver, sent_s, received[sender, receiver], ticks[receiver], age_max_s)
            )
    return FleetMessages({name: _spans(sent[name]) for name in fleet.flights}, tuple(links), tuple(problems))


def _age_max_s(fleet: Fleet, member: str) -> float:
    config = fleet.flights[member].config
    return AGE_MAX_S if config is None else config.fleet.age_max_s


def _spans(sent: list[_Sent]) -> tuple[Span, ...]:
    runs = [(key, next(run)[0]) for key, run in groupby(sent, key=lambda each: each[1:])]
    ends_s = [*(begin_s for _, begin_s in runs[1:]), sent[-1][0]] if sent else []
    return tuple(Span(begin_s, end_s, *key) for (key, begin_s), end_s in zip(runs, ends_s, strict=True))


def _link(
    sender: str,
    receiver: str,
    sent_s: list[float],
    received: list[tuple[float, float, Intent]],
    ticks_s: list[float],
    age_max_s: float,
) -> Link:
    begin_s, end_s = ticks_s[0], ticks_s[-1]
    sent = sum(begin_s <= t_s < end_s for t_s in sent_s)
    times_s = [t_s for t_s, _, _ in received]
    over = bool(received) and received[-1][2] is Intent.DOWN  # a landed sender may stop sending
    edges = np.array([begin_s, *times_s] if over else [begin_s, *times_s, end_s])
    gaps_s: Floats = np.diff(edges)
    silent = tuple(
        (float(edges[at] + age_max_s), float(edges[at + 1])) for at in np.flatnonzero(gaps_s > age_max_s)
    )
    late_max_s = max((late_s for _, late_s, _ in received), default=None)
    gap_max_s = float(gaps_s.max()) if len(gaps_s) else 0.0
    return Link(sender, receiver, sent, len(received), late_max_s, gap_max_s, silent)


def waited_s(spans: tuple[Span, ...]) -> float:
    """Return the time in which a member flew and gave way to neighbours, s."""
    return sum(span.end_s - span.begin_s for span in spans if span.waits)
