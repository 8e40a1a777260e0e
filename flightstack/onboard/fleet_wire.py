"""Status messages of a fleet: this vehicle sends its status in each tick, and receives those of the others.

Each process publishes ``MemberStatus`` on ``NAMESPACE/fleet/status`` and subscribes to ``**/fleet/status``.
With this pattern a process needs no list of namespaces, and also detects two processes with one vehicle id,
and vehicles that are not members. Like all keys of a vehicle, the key begins with the namespace, so that
access rules can name it.

In flight no call blocks. Rejected messages are counted; a text reports each doubling of the count.

``OtherClock`` estimates the offset between the clocks of two processes. A message arrives after it was sent.
With d = this clock - other clock at one moment:

    arrival at this process      - stamp of the other process  >=  d    minimum: ``ahead_ns``
    arrival at the other process - stamp of this process       >= -d    reported minimum: ``echo_ns``

So d lies between -echo_ns and ahead_ns. The estimate is the centre; the error bound is half the width: half
the sum of both directions' minimum delays. The delays need not be known or equal. Cristian's method (1989)
uses one round trip instead of the minimum delay in each direction.

Clocks drift, so both minimum values grow with their age by ``DRIFT_PPM``.
"""

from __future__ import annotations

import math
import secrets
import time
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

from bridge.zenoh import zenoh_link
from flightstack.common.pacing import Tick
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.sender_clock import Reading, SenderClock
from flightstack.core.types import MemberStatus
from logs.schema.controller_rows import Echo, received_status, status_row
from logs.schema.rows import MemberStatusRow
from logs.schema.schemas import CONTROLLER_NEIGHBOURS, MEMBER_STATUS

KEY = "fleet/status"
NEIGHBOURS = "controller/neighbours"  # log topic of the received messages
EVERY_MEMBER = f"**/{KEY}"
CAPACITY = 256  # maximum number of queued messages; the oldest ones are dropped
BYTES_MAX = 2048  # maximum size of an accepted message, bytes
PROOF_S = 0.3  # time for which messages must agree after a clock step, s; longer than the latency
ONE_WAY_S = 2.0  # duration of one-way reception after which a text reports it, s
NAMESAKE_S = 1.0  # time before the start for finding another process with the same vehicle id, s
# maximum drift between two clocks, ppm: Linux slews each of them by at most 500 ppm (adjtimex(2))
DRIFT_PPM = 1000


class Offset(NamedTuple):
    """Offset of this process's clock from that of another process."""

    ns: int  # estimate of the time on this clock minus that on the other clock, ns
    bound_ns: int  # bound of the error of this estimate, ns


class OtherClock:
    """Estimate of the clock of another process; call ``heard`` with each of its messages."""

    def __init__(self) -> None:
        # each minimum minus its growth since time zero of this process's clock; None: nothing was received
        self._ahead_ns: int | None = None
        self._echo_ns: int | None = None

    def heard(self, stamp_ns: int, arrival_ns: int, echo_ns: int | None) -> bool:
        """Add the times of a message; return whether these times agree with the earlier ones.

        If the times do not agree, one of the clocks has jumped, and the estimate restarts.

        ``stamp_ns``: stamp on the other clock; ``arrival_ns``: arrival on this process's clock; ``echo_ns``:
        minimum that the other process reports; None: it has received nothing from this process.
        """
        grown_ns = _growth_ns(arrival_ns)
        ahead_ns = arrival_ns - stamp_ns - grown_ns
        self._ahead_ns = ahead_ns if self._ahead_ns is None else min(ahead_ns, self._ahead_ns)
        if echo_ns is not None:
            self._echo_ns = echo_ns - grown_ns
        offset = self.offset(arrival_ns)
        if offset is None or offset.bound_ns >= 0:
            return True
        self._ahead_ns = self._echo_ns = None
        return False

    def ahead_ns(self, now_ns: int) -> int | None:
        """Return the value to send to the other process as its ``echo_ns``; None: nothing was received."""
        return None if self._ahead_ns is None else self._ahead_ns + _growth_ns(now_ns)

    def offset(self, now_ns: int) -> Offset | None:
        """Return this clock minus the other clock; None until both directions are known."""
        if self._ahead_ns is None or self._echo_ns is None:
            return None
        width_ns = self._ahead_ns + self._echo_ns + 2 * _growth_ns(now_ns)
        return Offset((self._ahead_ns - self._echo_ns) // 2, (width_ns + 1) // 2)


def _growth_ns(now_ns: int) -> int:
    """Return the growth of a minimum since zero of this process's clock, ns."""
    return now_ns * DRIFT_PPM // 1_000_000


class _Member:
    """Connection to the process of another member."""

    def __init__(self, fleet: Fleet) -> None:
        self.process: int | None = None
        self.clock = OtherClock()
        self.stamps = SenderClock(fleet.age_max_s, PROOF_S, fleet.latency_max_s)
        self.heard_ns = 0  # arrival time of the newest message on this clock, ns
        self.claim_ns: int | None = None
        self.claim_s = math.nan
        self.one_way_ns: int | None = None  # start of one-way reception, ns; None: both directions work
        self.said_one_way = False


class FleetWire:
    """Connection of this vehicle to the other members; this base class is for a vehicle without a fleet."""

    doubled = ""  # text about another process with this vehicle's id; empty: there is none
    topics: tuple[tuple[str, str], ...] = ()  # log topics of the messages, with their types

    def __init__(self) -> None:
        self._texts: list[str] = []  # texts for the operator since the last call of ``texts``

    def begin(self, epoch_ns: int, now_s: Callable[[], float]) -> None:
        """Set the clock of the ticks in real time; before this call no message is sent.

        ``epoch_ns``: Unix time at zero of the stack clock, ns; ``now_s``: function that reads this clock, s.
        """

    def namesake(self) -> str:
        """Listen for another process with this vehicle's id; return an error text if there is one."""
        return ""

    def await_tick(self, tick: Tick, stopped: Callable[[], bool]) -> None:
        """Wait for the messages of a tick in lockstep (in real time: no wait); ``stopped`` ends the wait."""

    def statuses(self) -> tuple[MemberStatus, ...]:
        """Return the newest message of each member since the last call."""
        return ()

    def say(self, message: MemberStatus | None) -> bytes | None:
        """Send ``Outputs.member_status`` to the other members; return its bytes for the log, or None."""
        del message
        return None

    def texts(self) -> list[str]:
        """Return the texts for the operator since the last call."""
        texts, self._texts = self._texts, []
        return texts

    def close(self) -> None:
        """Undeclare publisher and subscriber."""


FLEET_TOPICS = ((NEIGHBOURS, CONTROLLER_NEIGHBOURS), (KEY, MEMBER_STATUS))


class LiveStatuses(FleetWire):
    """Sender of this vehicle's messages in real time, and receiver of those of the other members."""

    topics = FLEET_TOPICS

    def __init__(self, session: zenoh_link.Session, namespace: str, fleet: Fleet) -> None:
        super().__init__()
        self._fleet = fleet
        self._opened_s = time.monotonic()
        self._process = secrets.randbits(64)
        self._members = {n: _Member(fleet) for n in fleet.others}
        self._rejected: Counter[str] = Counter()  # number of rejected messages by reason
        self._epoch_ns = 0
        self._now_s: Callable[[], float] = lambda: 0.0
        encoding = f"application/cdr;{MEMBER_STATUS}"
        self._publisher = zenoh_link.dropping_publisher(session, f"{namespace}/{KEY}", encoding)
        self._subscriber = zenoh_link.remote_subscriber(session, EVERY_MEMBER, CAPACITY)

    def begin(self, epoch_ns: int, now_s: Callable[[], float]) -> None:
        self._epoch_ns, self._now_s = epoch_ns, now_s

    def namesake(self) -> str:
        """Listen as in ``FleetWire``; messages received during this call are dropped."""
        time.sleep(max(0.0, self._opened_s + NAMESAKE_S - time.monotonic()))
        for row in self._rows():
            if row.id == self._fleet.id and row.process != self._process:
                self._hear_namesake()
        return self.doubled

    def statuses(self) -> tuple[MemberStatus, ...]:
        rows = self._rows()
        now_s = self._now_s()  # the clock is read after the queue, so no message is newer than this time
        now_ns = self._epoch_ns + round(now_s * 1e9)
        newest: dict[int, MemberStatus] = {}
        for row in rows:
            if self._is_of_member(row, now_ns):
                message = self._taken(row, now_s, now_ns)
                if message is not None:
                    newest[row.id] = message
        return tuple(newest[n] for n in sorted(newest))

    def say(self, message: MemberStatus | None) -> bytes | None:
        if message is None:
            return None
        now_ns = self._epoch_ns + round(message.stamp_s * 1e9)
        echoes = [
            Echo(n, member.process, ahead_ns)
            for n, member in self._members.items()
            if member.process is not None and (ahead_ns := member.clock.ahead_ns(now_ns)) is not None
        ]
        payload = status_row(message, self._epoch_ns, self._process, echoes).pack()
        self._publisher.put(payload)
        return payload

    def close(self) -> None:
        self._subscriber.undeclare()
        self._publisher.undeclare()

    def _reject(self, reason: str, detail: str = "") -> None:
        """Count a rejected message; store a text whenever the count for this reason has doubled."""
        self._rejected[reason] += 1
        if (count := self._rejected[reason]) & (count - 1) == 0:
            more = f" ({detail})" if detail else ""
            self._texts.append(f"fleet: {reason}{more}: {count} messages rejected")

    def _rows(self) -> list[MemberStatusRow]:
        rows = []
        for sample in zenoh_link.drain(self._subscriber):
            payload = sample.payload.to_bytes()
            if len(payload) > BYTES_MAX:
                self._reject("malformed", f"{len(payload)} bytes, allowed are {BYTES_MAX}")
                continue
            try:
                rows.append(MemberStatusRow.unpack(payload))
            except ValueError as error:
                self._reject("malformed", str(error))
        return rows

    def _hear_namesake(self) -> None:
        what = f"another process has the vehicle id {self._fleet.id} of this one"
        self._reject(what)
        self.doubled = f"fleet: {what}: end it, or give one of them another id"

    def _is_of_member(self, row: MemberStatusRow, now_ns: int) -> bool:
        """Whether a message comes from another member; of two processes with one id, the first is valid."""
        if row.id == self._fleet.id:
            if row.process != self._process:  # the network can return messages of this process
                self._hear_namesake()
            return False
        member = self._members.get(row.id)
        if member is None:
            self._reject(f"vehicle {row.id} is no member")
            return False
        if member.process == row.process:
            return True
        silent_s = (now_ns - member.heard_ns) * 1e-9
        if member.process is not None and silent_s <= self._fleet.silent_flight_s:
            self._reject(f"two processes have the vehicle id {row.id}")
            return False
        if member.process is not None:
            self._texts.append(f"fleet: vehicle {row.id} has a new process after {silent_s:.1f} s")
        member = self._members[row.id] = _Member(self._fleet)
        member.process = row.process
        return True

    def _taken(self, row: MemberStatusRow, now_s: float, now_ns: int) -> MemberStatus | None:
        """Convert a message to times of this clock; None: it is outdated, or its time is too uncertain."""
        member, fleet = self._members[row.id], self._fleet
        # the short patience PROOF_S is safe: the bound of the offset covers the delays of queued messages
        reading = member.stamps.accept(row.stamp_ns / 1e9, now_ns / 1e9, PROOF_S)
        if reading is Reading.AHEAD or reading is Reading.UNUSABLE:
            self._reject(f"the clock of vehicle {row.id}, or of this one, has jumped")
        if not reading.good:
            return None
        if reading is Reading.STEPPED:
            member.clock = OtherClock()
        member.heard_ns = now_ns
        echoes = [ns for n, process, ns in row.echoes if (n, process) == (fleet.id, self._process)]
        if not member.clock.heard(row.stamp_ns, now_ns, echoes[0] if echoes else None):
            self._reject(f"the clock of vehicle {row.id}, or of this one, has jumped")
            return None
        self._note_one_way(member, row.id, now_ns, heard=bool(echoes))
        offset = member.clock.offset(now_ns)
        if offset is None:
            return None
        bound_s = offset.bound_ns * 1e-9
        if bound_s > fleet.latency_max_s:
            self._reject(
                f"the clock of vehicle {row.id} is not known accurately",
                f"to {bound_s:.3f} s, fleet.latency_max_s is {fleet.latency_max_s:g}",
            )
            return None
        if not row.claims:
            member.claim_ns, member.claim_s = None, math.nan
        elif row.claim_ns != member.claim_ns:  # a new claim is converted once, so that its bits remain equal
            member.claim_ns = row.claim_ns
            member.claim_s = (row.claim_ns + offset.ns - self._epoch_ns) / 1e9
        stamp_s = (row.stamp_ns + offset.ns - self._epoch_ns) / 1e9
        try:
            return received_status(row, stamp_s, now_s, member.claim_s, bound_s)
        except ValueError as error:
            self._reject("malformed", str(error))
            return None

    def _note_one_way(self, member: _Member, n: int, now_ns: int, *, heard: bool) -> None:
        """Report once that messages arrive from a member, but the member receives none from this vehicle."""
        if heard:
            member.one_way_ns, member.said_one_way = None, False
            return
        if member.one_way_ns is None:
            member.one_way_ns = now_ns
        if not member.said_one_way and (now_ns - member.one_way_ns) * 1e-9 > ONE_WAY_S:
            member.said_one_way = True
            self._texts.append(
                f"fleet: vehicle {n} receives no messages of this one: are they connected directly or "
                "by a router, and is this one's id among its members?"
            )
