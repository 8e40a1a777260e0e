"""Faults of the MAVLink wire: what becomes of a message, both ways."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from sim.faults.content import REWRITES, Delivery, Rewrite
from sim.faults.schedule import Running
from sim.scenarios.fault_table import Kind, What


class Way(Enum):
    """Direction, seen from the vehicle."""

    IN = "in"
    OUT = "out"


class Fate(NamedTuple):
    """What becomes of a message."""

    due_ns: tuple[int, ...]  # when it arrives; none: never, two: twice
    damaged: bool = False  # its checksum does not fit
    stall: Running | None = None  # it waits for the end of this fault


# direction and messages (None: all) that a fault concerns
CONCERNS: dict[What, tuple[Way, frozenset[int] | None]] = {
    What.LINK_OUT: (Way.OUT, None),
    What.LINK_IN: (Way.IN, None),
    What.HEARTBEAT: (Way.OUT, frozenset({dialect.MAVLINK_MSG_ID_HEARTBEAT})),
    What.SETPOINTS: (Way.IN, frozenset({dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED})),
    What.CLOCK: (Way.OUT, None),
}
# whoever injects faults must be able to end them
_COMMANDS = frozenset(
    {
        dialect.MAVLINK_MSG_ID_COMMAND_LONG,
        dialect.MAVLINK_MSG_ID_COMMAND_INT,
        dialect.MAVLINK_MSG_ID_COMMAND_ACK,
    }
)


@dataclass(slots=True)
class _One:
    """One running fault: a change of content, a delivery, or what only the wire can do."""

    running: Running
    way: Way
    ids: frozenset[int] | None
    rewrite: Rewrite | None
    delivery: Delivery | None


class LinkFaults:
    """Running faults of one vehicle's wire; the process asks for the fate of every message."""

    def __init__(self) -> None:
        self._running: list[_One] = []

    def begin(self, running: Running) -> None:
        """A fault is on."""
        fault = running.fault
        way, ids = CONCERNS[fault.what]
        make = REWRITES.get((fault.what, fault.kind))
        wire_only = fault.kind in (Kind.STUCK, Kind.GARBAGE)
        self._running.append(
            _One(
                running,
                way,
                ids,
                make(running) if make is not None else None,
                Delivery(running) if make is None and not wire_only else None,
            )
        )

    def end(self, running: Running, now_ns: int) -> None:
        """It is over; the wire lets go of what waited for it."""
        del now_ns
        self._running = [one for one in self._running if one.running is not running]

    def active(self, way: Way) -> bool:
        """Whether messages in this direction have to go through ``fate``."""
        return bool(self._running) and any(one.way is way for one in self._running)

    def fate(self, way: Way, message: Message, now_ns: int) -> Fate:
        """Decide on one message, which may be changed in place; call it once a message, in order.

        Args:
            way: direction.
            message: decoded, or about to be packed.
            now_ns: simulated time.
        """
        id_: int = message.get_msgId()
        if id_ in _COMMANDS and message.command == dialect.MAV_CMD_INJECT_FAILURE:
            return Fate((now_ns,))
        due, damaged, stall = [now_ns], False, None
        for one in self._running:
            if one.way is not way or (one.ids is not None and id_ not in one.ids):
                continue
            if one.rewrite is not None:
                one.rewrite(message, now_ns)
            elif one.delivery is not None:
                due = one.delivery.apply(due, now_ns)
            elif one.running.fault.kind is Kind.STUCK:
                stall = one.running
            elif one.running.rng.random() < one.running.fault.amount:
                damaged = True
        return Fate(tuple(due), damaged, stall)
