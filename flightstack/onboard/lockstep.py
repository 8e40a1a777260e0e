"""Lockstep of the onboard process: the vehicle requests a tick, the target reports its sample counts.

No order between MAVLink and Zenoh is assumed. A tick starts when the vehicle has requested it by TIMESYNC,
the target has reported the number of samples that belong to it, and, in a fleet, the members' messages have
arrived (docs/how_it_works/lockstep.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable

from msgspec import msgpack

from bridge.mavlink.client.link import VehicleLink
from bridge.target.odometry import RawSample, SampleSource
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import (
    EPOCH_NS,
    NO_GO,
    RUN_AHEAD_TICKS,
    Tick,
    wait_until,
)
from flightstack.core.types import MemberStatus
from flightstack.onboard.fleet_wire import FLEET_TOPICS, FleetWire
from flightstack.onboard.leaving import Person
from flightstack.onboard.runner import Arrived, ClockStoppedError, LinkedVehicle, decoded
from logs.schema.controller_rows import pack_neighbours, status_row, unpack_neighbours

CREDIT_EVERY = 10  # number of ticks between two credits (messages that allow the target to continue)
WAIT_SLICE_S = 0.05  # wall time between two checks for signals during a wait, s
FIRST_WAIT_MAX_S = 600.0  # maximum wall time of a wait for a first message, s; some senders compile first
# wall time without a message after which the simulated world counts as dead, s: on a busy computer a
# process can wait for the processor for many seconds, and the world waits for all onboard processes
WORLD_SILENT_S = 75.0
TOLD, HEARD = "sim/fleet/told", "sim/fleet/heard"  # keys of messages from and to a member


class VehicleTicks(LinkedVehicle):
    """Vehicle that requests the ticks by TIMESYNC; the default is not to wait for a missing request."""

    def __init__(self, link: VehicleLink, rate_hz: int, stopped: Callable[[], bool] = lambda: True) -> None:
        super().__init__(link, lockstep=True)
        self._rate_hz, self._stopped = rate_hz, stopped
        self._last_ns = -1  # simulated time of the newest request, ns
        self._began_s: float | None = None  # wall time of the newest tick, s

    def passed(self, sim_ns: int) -> None:
        """Record the simulated time of the last tick of a batch."""
        self._last_ns = sim_ns

    def wait(self) -> Tick:
        """Wait for the vehicle's request, in bounded wall time."""
        last_ns = self._last_ns
        if last_ns < 0:
            most_s, what = FIRST_WAIT_MAX_S, "the vehicle to request its first tick"
        else:  # the vehicle requests the next tick only after it has flown the current one
            most_s, what = WORLD_SILENT_S, ""
            self.link.endpoint.wait(WAIT_SLICE_S)
        in_time = wait_until(self._requested, self._stopped, most_s, pause_s=0.0, what=what)
        if self._last_ns != last_ns:
            return self._tick()
        if last_ns < 0 and not in_time:
            raise ClockStoppedError(f"no vehicle requested a tick within {most_s:g} s (TIMESYNC)")
        raise ClockStoppedError("no further message from the vehicle")

    def _tick(self) -> Tick:
        """Return the tick of the newest request; its ``period_s`` is wall time."""
        last_s, self._began_s = self._began_s, time.perf_counter()
        period_s = self._began_s - last_s if last_s is not None else 0.0
        now_s = self._last_ns / 1e9
        return Tick(round(now_s * self._rate_hz), now_s, EPOCH_NS + self._last_ns, period_s, 0.0)

    def _requested(self) -> bool:
        """Whether a new request has arrived; if not, wait at most ``WAIT_SLICE_S`` for one."""
        link = self.link
        link.poll(max(0, self._last_ns) / 1e9)
        sim_ns = link.take_timesync()
        if sim_ns is not None and sim_ns != self._last_ns:
            self._last_ns = sim_ns
            return True
        if sim_ns is not None:  # the vehicle has repeated its request
            link.endpoint.repeat(self.reply)
        link.endpoint.wait(WAIT_SLICE_S)
        return False


class LockstepWires(VehicleTicks):
    """Wires in lockstep: a tick starts when vehicle, target and fleet have all reached it."""

    def __init__(
        self, link: VehicleLink, rate_hz: int, odometry: SampleSource, session: zenoh_link.Session,
        namespace: str, person: Person, fleet: FleetWire,
    ) -> None:  # fmt: skip
        super().__init__(link, rate_hz, person.left)
        self._person, self._fleet, self._odometry = person, fleet, odometry
        self.statuses = fleet.statuses
        self._ticks = zenoh_link.fifo_subscriber(session, f"{namespace}/sim/target/ticks")
        self._credit = zenoh_link.blocking_publisher(session, f"{namespace}/sim/credit")
        self._counts: dict[int, int] = {}  # number of samples up to a tick, by tick
        self._pool: list[RawSample] = []  # received samples of later ticks
        self._released: list[RawSample] = []  # samples of the current tick
        self._taken = 0  # number of samples up to the current tick
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
        number, stopped = tick.number, self._stopped
        if number % CREDIT_EVERY == 0:
            self._give_credit(number)
        if not self._target_gone:
            most_s = WORLD_SILENT_S if number else FIRST_WAIT_MAX_S
            came = wait_until(lambda: self._complete(number), stopped, most_s)
            self._target_gone = not came or stopped()
        due = self._counts.pop(number, self._taken + len(self._pool)) - self._taken
        self._released, self._pool = self._pool[:due], self._pool[due:]
        self._taken += len(self._released)
        self._fleet.await_tick(tick, stopped)
        return tick

    def samples(self, now_s: float) -> Arrived:
        """Return the samples of this tick."""
        return decoded(self._released, now_s)

    def landing_began(self, tick: int) -> None:
        """Send the target its first driving tick: the first one that the target cannot have simulated yet."""
        self._go_tick = tick + RUN_AHEAD_TICKS + 1
        self._give_credit(tick)

    def _give_credit(self, tick: int) -> None:
        self._credit.put(msgpack.encode((tick, self._go_tick)))

    def _complete(self, tick: int) -> bool:
        """Whether the number of samples up to this tick, and all these samples, have arrived."""
        if tick not in self._counts:
            for sample in zenoh_link.drain(self._ticks):
                first, counts = msgpack.decode(sample.payload.to_bytes(), type=tuple[int, list[int]])
                self._counts.update(enumerate(counts, first))
        if tick not in self._counts:
            return False
        if self._taken + len(self._pool) < self._counts[tick]:
            self._pool += self._odometry.poll()
        return self._taken + len(self._pool) >= self._counts[tick]


class LockstepStatuses(FleetWire):
    """Fleet messages in lockstep: each message reaches the other members in a later tick.

    The vehicles' simulator receives the messages of all members and distributes them tick by tick, so that
    their order does not depend on wall time. No other process has this vehicle's id, because the launcher
    starts one process per vehicle.
    """

    topics = FLEET_TOPICS

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        super().__init__()
        self._heard = zenoh_link.fifo_subscriber(session, f"{namespace}/{HEARD}")
        self._told = zenoh_link.blocking_publisher(session, f"{namespace}/{TOLD}")
        self._inbox: dict[int, list[bytes]] = {}  # packed messages by tick
        self._tick: Tick | None = None
        self._gone = False

    def await_tick(self, tick: Tick, stopped: Callable[[], bool]) -> None:
        """Wait for the messages of a tick, in bounded wall time.

        The first tick has no messages: wait for the simulator's subscription to this vehicle's messages.
        """
        first, self._tick = self._tick is None, tick

        def come() -> bool:
            return zenoh_link.is_matched(self._told) if first else self._has(tick.number)

        if not self._gone and (not wait_until(come, stopped, WORLD_SILENT_S) or stopped()):
            self._gone = True
            self._texts.append("fleet: no messages arrived with this tick: continuing without")

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
        self._told.put(msgpack.encode((tick.number, False, payload)))
        return status_row(message, EPOCH_NS, 0).pack() if message is not None else None

    def close(self) -> None:
        """Send a last message, so that no process waits for one; undeclare publisher and subscriber."""
        self._told.put(msgpack.encode((self._tick.number if self._tick is not None else -1, True, b"")))
        self._heard.undeclare()
        self._told.undeclare()

    def _has(self, tick: int) -> bool:
        for sample in zenoh_link.drain(self._heard):
            number, messages = msgpack.decode(sample.payload.to_bytes(), type=tuple[int, list[bytes]])
            if number >= tick:
                self._inbox[number] = messages
        return tick in self._inbox
