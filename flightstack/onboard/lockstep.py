"""Lockstep on the side of the onboard process: the vehicle sends the tick, the target counts its samples.

Order between MAVLink and Zenoh is never assumed: a tick begins when the vehicle has asked for it by TIMESYNC
and the target has said, tick by tick, how many samples belong to it (docs/how_it_works/lockstep.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable

from bridge.target.odometry import RawSample, SampleSource
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import (
    NO_GO,
    PAIR,
    RUN_AHEAD_TICKS,
    TARGET_SILENT_S,
    LockstepClock,
    Silence,
    Tick,
)
from flightstack.onboard.leaving import LAND_SHOWN_MAX_S, Person
from flightstack.onboard.runner import Arrived, ClockStoppedError, LinkedVehicle, decoded

CREDIT_EVERY = 10  # ticks
WAIT_SLICE_S = 0.05  # s of wall time between looks at the signals while waiting
FIRST_WAIT_MAX_S = 30.0  # s of wall time until vehicle and target have shown up
LOST_RUN_MAX_S = 15.0  # s of wall time without the vehicle after which the process ends


class Patience:
    """Wall time for which a process in lockstep that is to end still waits for the others' ticks.

    Args:
        person: who may end it.
    """

    def __init__(self, person: Person) -> None:
        self._person = person
        self._since_s: float | None = None

    def over(self) -> bool:
        """Return whether it waits no longer."""
        if not self._person.stop:
            return False
        now_s = time.monotonic()
        if self._since_s is None:
            self._since_s = now_s
        return now_s - self._since_s >= LAND_SHOWN_MAX_S


class VehicleTicks:
    """Ticks of the vehicle: it asks for each by TIMESYNC.

    Args:
        vehicle: whose link is polled.
        rate_hz: ticks in a second.
        stopped: whether it is no longer waited for; by default one that has not asked is not waited for.
    """

    def __init__(
        self, vehicle: LinkedVehicle, rate_hz: int, stopped: Callable[[], bool] = lambda: True
    ) -> None:
        self._vehicle, self._clock, self._stopped = vehicle, LockstepClock(rate_hz), stopped
        self._last_ns = -1

    def wait(self) -> Tick:
        """Wait until the vehicle asks, for a bounded wall time.

        Raises:
            ClockStoppedError: it does not.
        """
        link = self._vehicle.link
        most_s, silence = FIRST_WAIT_MAX_S if self._last_ns < 0 else LOST_RUN_MAX_S, Silence()
        while True:
            link.poll(max(0, self._last_ns) / 1e9)
            sim_ns = link.take_timesync()
            if sim_ns is not None and sim_ns != self._last_ns:
                self._last_ns = sim_ns
                return self._clock.tick(sim_ns)
            if sim_ns is not None:
                link.endpoint.repeat(self._vehicle.reply)
            if self._stopped() or silence.look() > most_s:
                raise ClockStoppedError("the vehicle fell silent")
            link.endpoint.wait(WAIT_SLICE_S)


class LockstepWires:
    """Clock and source of target samples: a tick begins when vehicle and target have both come to it.

    Args:
        ticks: of the vehicle.
        odometry: the target's samples.
        session: on which the target says how many of them belong to each tick.
        namespace: first part of its keys.
        person: who may end the process.
    """

    def __init__(
        self,
        vehicle: LinkedVehicle,
        rate_hz: int,
        odometry: SampleSource,
        session: zenoh_link.Session,
        namespace: str,
        person: Person,
    ) -> None:
        self._person, self._stopped = person, Patience(person).over
        self._ticks = VehicleTicks(vehicle, rate_hz, self._stopped)
        self._odometry = odometry
        self._markers = zenoh_link.fifo_subscriber(session, f"{namespace}/sim/target/tick")
        self._credit = zenoh_link.blocking_publisher(session, f"{namespace}/sim/credit")
        self._marker_tick, self._received = -1, 0
        self._pool: list[RawSample] = []  # received, of which the target has not yet said the tick
        self._released: list[RawSample] = []  # of this tick
        self._counts: dict[int, int] = {}
        self._go_tick = NO_GO
        self._target_gone = False

    def wait(self) -> Tick:
        """Wait for the vehicle, then for the target; each for a bounded wall time.

        Raises:
            ClockStoppedError: the vehicle does not come, or the process is to end.
        """
        try:
            tick = self._ticks.wait()
        except ClockStoppedError:
            if self._person.stop:
                raise ClockStoppedError("ended by the operator") from None
            raise
        self._released = self._release(tick.number)
        return tick

    def samples(self, now_s: float) -> Arrived:
        """Return the samples of this tick."""
        return decoded(self._released, now_s)

    def landing_began(self, tick: int) -> None:
        """Tell the target when it may drive: after the last tick that it may already have computed."""
        self._go_tick = tick + RUN_AHEAD_TICKS + 1
        self._give_credit(tick)

    def _give_credit(self, tick: int) -> None:
        self._credit.put(PAIR.pack(tick, self._go_tick))

    def _release(self, tick: int) -> list[RawSample]:
        """Wait for the samples that the target released up to this tick; those that came if it is gone."""
        if tick % CREDIT_EVERY == 0:
            self._give_credit(tick)
        most_s, silence = FIRST_WAIT_MAX_S if self._marker_tick < 0 else TARGET_SILENT_S, Silence()
        repeat_at = time.monotonic() + WAIT_SLICE_S
        while not self._target_gone and not self._complete(tick):
            now = time.monotonic()
            if silence.look() > most_s or self._stopped():
                self._target_gone = True
            if now > repeat_at:
                self._give_credit(tick)
                repeat_at = now + WAIT_SLICE_S
            time.sleep(2e-5)
        due = self._counts.pop(tick, self._received + len(self._pool)) - self._received
        released, self._pool = self._pool[:due], self._pool[due:]
        self._received += len(released)
        return released

    def _complete(self, tick: int) -> bool:
        """Return whether the marker of this tick has arrived, and all samples that it counts."""
        for sample in zenoh_link.drain(self._markers):
            number, count = PAIR.unpack(sample.payload.to_bytes())
            self._counts[number] = count
            self._marker_tick = max(self._marker_tick, number)
        self._pool += self._odometry.poll()
        return tick in self._counts and self._received + len(self._pool) >= self._counts[tick]
