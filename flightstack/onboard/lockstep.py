"""Lockstep of the onboard process: the vehicle requests each tick, the target reports its sample count.

No order between MAVLink and Zenoh is assumed. A tick starts when the vehicle has requested it by TIMESYNC,
the target has reported the number of samples that belong to it, and, in a fleet, the members' messages have
arrived (docs/how_it_works/lockstep.md).
"""

from __future__ import annotations

import contextlib
import math
import sys
import time
from collections.abc import Callable

import msgspec

from bridge.mavlink.client.link import VehicleLink
from bridge.target.odometry import RawSample, SampleSource
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import (
    EPOCH_NS,
    NO_GO,
    PAIR,
    RUN_AHEAD_TICKS,
    TARGET_LOOK_S,
    TARGET_SILENT_S,
    LockstepClock,
    Silence,
    Tick,
)
from flightstack.core.parameters.fleet import ALONE
from flightstack.core.types import MemberStatus
from flightstack.onboard.fleet_wire import FleetWire
from flightstack.onboard.leaving import Person
from flightstack.onboard.runner import Arrived, ClockStoppedError, LinkedVehicle, decoded
from logs.schema.controller_rows import pack_neighbours, status_row, unpack_neighbours

CREDIT_EVERY = 10  # ticks between two messages that let the target continue
WAIT_SLICE_S = 0.05  # wall time between checks for signals during a wait, s
FIRST_WAIT_MAX_S = 600.0  # longest wait for a first message, s of wall time; it includes compilation
SAID_S = 10.0  # waiting time after which a text reports the wait, s
# wall time without the vehicle's request after which the process ends, s; the vehicle may wait for the robot
LOST_RUN_MAX_S = TARGET_SILENT_S + 15.0
ALIVE = "sim/target/alive"  # Zenoh liveliness token of the robot's process in lockstep
TOLD, HEARD = "sim/fleet/told", "sim/fleet/heard"  # keys in the namespace of a member, in lockstep
OVER = 1  # second value of the last message of a member


class VehicleTicks(LinkedVehicle):
    """Vehicle that requests the ticks by TIMESYNC; by default, it does not wait for a missing request."""

    def __init__(self, link: VehicleLink, rate_hz: int, stopped: Callable[[], bool] = lambda: True) -> None:
        super().__init__(link, lockstep=True)
        self._clock, self._stopped = LockstepClock(rate_hz), stopped
        self._last_ns = -1

    def passed(self, sim_ns: int) -> None:
        """Record the time of ticks that were run as a batch."""
        self._last_ns = sim_ns

    def wait(self) -> Tick:
        """Wait for the vehicle's request, in bounded wall time."""
        link = self.link
        first, silence = self._last_ns < 0, None
        most_s, due_s = (FIRST_WAIT_MAX_S, SAID_S) if first else (LOST_RUN_MAX_S, math.inf)
        if self._last_ns >= 0:  # the vehicle requests the next tick only after it has flown this one
            link.endpoint.wait(WAIT_SLICE_S)
        while True:
            link.poll(max(0, self._last_ns) / 1e9)
            sim_ns = link.take_timesync()
            if sim_ns is not None and sim_ns != self._last_ns:
                self._last_ns = sim_ns
                return self._clock.tick(sim_ns)
            if sim_ns is not None:
                link.endpoint.repeat(self.reply)
            if silence is None:  # not needed before: usually the request has already arrived
                silence = Silence()
            waited_s = silence.look()
            if self._stopped() or waited_s > most_s:
                never = f"no vehicle requested a tick within {most_s:g} s (TIMESYNC)"
                raise ClockStoppedError(
                    never if first and waited_s > most_s else "no further message from the vehicle"
                )
            if waited_s > due_s:
                due_s = math.inf
                text = "onboard: waits for the vehicle to request its first tick"
                with contextlib.suppress(OSError):  # standard error may be closed
                    print(text, file=sys.stderr, flush=True)
            link.endpoint.wait(WAIT_SLICE_S)


class LockstepWires(VehicleTicks):
    """Wires in lockstep: a tick starts when vehicle, target and fleet have all reached it."""

    def __init__(
        self, link: VehicleLink, rate_hz: int, odometry: SampleSource, session: zenoh_link.Session,
        namespace: str, person: Person, fleet: FleetWire,
    ) -> None:  # fmt: skip
        super().__init__(link, rate_hz, person.left)
        self._person, self._fleet, self._odometry = person, fleet, odometry
        self.statuses = fleet.statuses
        self._markers = zenoh_link.fifo_subscriber(session, f"{namespace}/sim/target/tick")
        self._credit = zenoh_link.blocking_publisher(session, f"{namespace}/sim/credit")
        self._session, self._alive_key = session, f"{namespace}/{ALIVE}"
        self._marker_tick, self._received = -1, 0
        self._pool: list[RawSample] = []  # received samples whose tick is not yet known
        self._released: list[RawSample] = []  # samples of the current tick
        self._counts: dict[int, int] = {}
        self._go_tick = NO_GO
        self._target_gone = False

    def wait(self) -> Tick:
        """Wait for the vehicle, then for target and fleet messages, each in bounded wall time."""
        try:
            tick = super().wait()
        except ClockStoppedError:
            if self._person.stop:
                raise ClockStoppedError("ended by the operator") from None
            raise
        self._released = self._release(tick.number)
        self._fleet.await_tick(tick, self._person.left)
        return tick

    def samples(self, now_s: float) -> Arrived:
        """Return the samples of this tick."""
        return decoded(self._released, now_s)

    def landing_began(self, tick: int) -> None:
        """Send the target the tick from which it may drive: the first tick that it cannot have computed."""
        self._go_tick = tick + RUN_AHEAD_TICKS + 1
        self._give_credit(tick)

    def _give_credit(self, tick: int) -> None:
        self._credit.put(PAIR.pack(tick, self._go_tick))

    def _release(self, tick: int) -> list[RawSample]:
        """Wait for the samples that the target released up to this tick; return those that arrived."""
        if tick % CREDIT_EVERY == 0:
            self._give_credit(tick)
        most_s, silence = FIRST_WAIT_MAX_S if self._marker_tick < 0 else TARGET_SILENT_S, Silence()
        repeat_at = time.monotonic() + WAIT_SLICE_S
        while not self._target_gone and not self._complete(tick):
            now, silent_s = time.monotonic(), silence.look()
            if silent_s > most_s or self._person.left():
                self._target_gone = True
            if now > repeat_at:
                self._give_credit(tick)
                repeat_at = now + WAIT_SLICE_S
                if self._marker_tick >= 0 and silent_s > TARGET_LOOK_S:
                    self._target_gone = not zenoh_link.is_alive(self._session, self._alive_key)
            time.sleep(2e-5)
        due = self._counts.pop(tick, self._received + len(self._pool)) - self._received
        released, self._pool = self._pool[:due], self._pool[due:]
        self._received += len(released)
        return released

    def _complete(self, tick: int) -> bool:
        """Whether the marker of this tick and all samples that it counts have arrived."""
        for sample in zenoh_link.drain(self._markers):
            number, count = PAIR.unpack(sample.payload.to_bytes())
            self._counts[number] = count
            self._marker_tick = max(self._marker_tick, number)
        self._pool += self._odometry.poll()
        return tick in self._counts and self._received + len(self._pool) >= self._counts[tick]


class LockstepStatuses(FleetWire):
    """Fleet messages in lockstep: other members receive a message in a later tick.

    The vehicles' simulator receives the messages of all members and distributes them tick by tick, so that
    their order does not depend on wall time. This class replaces ``FleetWire``, which needs real time. No
    other process has this vehicle's id, because the launcher starts one process per vehicle.
    """

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        super().__init__(session, namespace, ALONE)
        self._heard = zenoh_link.fifo_subscriber(session, f"{namespace}/{HEARD}")
        self._told = zenoh_link.blocking_publisher(session, f"{namespace}/{TOLD}")
        self._inbox: dict[int, list[bytes]] = {}  # packed messages by tick
        self._tick: Tick | None = None
        self._gone = False

    def await_tick(self, tick: Tick, stopped: Callable[[], bool]) -> None:
        """Wait for the messages of a tick, in bounded wall time.

        The first tick has no messages; it waits for the simulator's subscription to this vehicle's messages.
        """
        first, self._tick, silence = self._tick is None, tick, Silence()
        come = self._is_heard if first else self._has
        while not self._gone and not come(tick.number):
            if silence.look() > LOST_RUN_MAX_S or stopped():
                self._gone = True
                self._counts.texts.append("fleet: no messages arrived with this tick: continuing without")
            time.sleep(2e-5)

    def statuses(self) -> tuple[MemberStatus, ...]:
        tick = self._tick
        if tick is None:
            return ()
        found = [message for each in self._inbox.pop(tick.number, ()) for message in unpack_neighbours(each)]
        return tuple(message._replace(arrival_s=tick.now_s) for message in found)

    def say(self, message: MemberStatus | None) -> bytes | None:
        """Send the message of this tick; without a message, send an empty one."""
        tick = self._tick
        if tick is None:
            return None
        payload = pack_neighbours(tick, (message,)) if message is not None else b""
        self._told.put(payload, attachment=PAIR.pack(tick.number, 0))
        return status_row(message, EPOCH_NS, 0).pack() if message is not None else None

    def close(self) -> None:
        """Send a last message, so that no process waits for one; undeclare publisher and subscriber."""
        self._told.put(b"", attachment=PAIR.pack(self._tick.number if self._tick is not None else -1, OVER))
        self._heard.undeclare()
        self._told.undeclare()

    def _is_heard(self, tick: int) -> bool:
        del tick
        return zenoh_link.is_matched(self._told)

    def _has(self, tick: int) -> bool:
        for sample in zenoh_link.drain(self._heard):
            number, _ = PAIR.unpack(sample.attachment.to_bytes())
            if number >= tick:
                self._inbox[number] = msgspec.msgpack.decode(sample.payload.to_bytes(), type=list[bytes])
        return tick in self._inbox
