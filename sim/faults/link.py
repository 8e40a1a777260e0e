"""Faults of the MAVLink wire in both directions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from sim.faults.content import Rewrite, rewrite_of
from sim.faults.samples import LOST, Lost
from sim.faults.schedule import Running
from sim.plant.sensors import NS
from sim.scenarios.fault_spec import Kind, What


class Way(Enum):
    """Direction, seen from the vehicle."""

    IN = "in"
    OUT = "out"


class Fate(NamedTuple):
    """Effect of the faults on a message."""

    due_ns: tuple[int, ...]  # arrival times; empty: lost; two: duplicated
    damaged: bool = False  # wrong checksum
    stall: Running | None = None  # the message waits for the end of this fault


# direction and messages (None: all) that a fault concerns
CONCERNS: dict[What, tuple[Way, frozenset[int] | None]] = {
    What.LINK_OUT: (Way.OUT, None),
    What.LINK_IN: (Way.IN, None),
    What.HEARTBEAT: (Way.OUT, frozenset({dialect.MAVLINK_MSG_ID_HEARTBEAT})),
    What.SETPOINTS: (Way.IN, frozenset({dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED})),
    What.CLOCK: (Way.OUT, None),
}
# the command that ends faults must arrive
_COMMANDS = frozenset(
    {
        dialect.MAVLINK_MSG_ID_COMMAND_LONG,
        dialect.MAVLINK_MSG_ID_COMMAND_INT,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
    }
)


HELD_BACK_NS = 30_000_000  # delay of a reordered message: three ticks at 100 Hz

Due = list[int]  # arrival times of a message, ns; empty: lost; two: duplicated


def _later(due: Due, by_ns: int) -> Due:
    return [at_ns + by_ns for at_ns in due]


DUE: Mapping[Kind, Callable[[Running, Due], Due]] = {
    Kind.DELAYED: lambda running, due: _later(due, round(running.fault.amount * NS)),
    Kind.REORDER: lambda running, due: _later(due, HELD_BACK_NS) if running.happens() else due,
    Kind.DUPLICATE: lambda running, due: due + due if running.happens() else due,
}


class _One(NamedTuple):
    """One running fault."""

    running: Running
    rewrite: Rewrite | None
    lost: Lost | None


class LinkFaults:
    """Active faults of one vehicle's wire; every message passes ``fate``."""

    def __init__(self) -> None:
        self._running: list[_One] = []

    def begin(self, running: Running) -> None:
        rewrite, lost = rewrite_of(running), LOST.get(running.fault.kind)
        self._running.append(_One(running, rewrite, None if lost is None else lost(running)))

    def end(self, running: Running, now_ns: int) -> None:
        """End a fault; messages that waited for it are released."""
        del now_ns
        self._running = [one for one in self._running if one.running is not running]

    def active(self, way: Way) -> bool:
        """Whether messages in this direction have to pass ``fate``."""
        if not self._running:
            return False
        return any(CONCERNS[one.running.fault.what][0] is way for one in self._running)

    def fate(self, way: Way, message: Message, now_ns: int) -> Fate:
        """Effect on one message, which may be changed in place; called once for each message, in order."""
        id_: int = message.get_msgId()
        if id_ in _COMMANDS and message.command == dialect.MAV_CMD_INJECT_FAILURE:
            return Fate((now_ns,))
        due, damaged, stall = [now_ns], False, None
        for running, rewrite, lost in self._running:
            concerned, ids = CONCERNS[running.fault.what]
            kind = running.fault.kind
            if concerned is not way or (ids is not None and id_ not in ids):
                continue
            if rewrite is not None:
                rewrite(message, now_ns)
            elif lost is not None:
                due = [] if lost(now_ns) else due
            elif kind in DUE:
                due = DUE[kind](running, due)
            elif kind is Kind.STUCK:
                stall = running
            elif running.happens():  # garbage
                damaged = True
        return Fate(tuple(due), damaged, stall)
