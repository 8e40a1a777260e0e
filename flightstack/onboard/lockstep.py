"""Lockstep on the side of the onboard process: the vehicle sends the tick, the target counts its samples.

Order between MAVLink and Zenoh is never assumed: a tick begins when the vehicle has asked for it by TIMESYNC
and the target has said, tick by tick, how many samples belong to it (docs/how_it_works/lockstep.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable

from bridge.mavlink.client.link import VehicleLink
from bridge.target.odometry import RawSample, SampleSource
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import NO_GO, PAIR, RUN_AHEAD_TICKS

CREDIT_EVERY = 10  # ticks
WAIT_SLICE_S = 0.05  # s of wall time between looks at the signals while waiting
FIRST_WAIT_MAX_S = 30.0  # s of wall time until vehicle and target have shown up
LATER_WAIT_MAX_S = 3.0  # s of wall time after which a target that stopped counts as gone
LOST_RUN_MAX_S = 15.0  # s of wall time without the vehicle after which the process ends


class LockstepWires:
    """Waits for the vehicle's tick and the target's, each bounded in wall time."""

    def __init__(
        self,
        link: VehicleLink,
        odometry: SampleSource,
        session: zenoh_link.Session,
        namespace: str,
        stopped: Callable[[], bool],
    ) -> None:
        self._link, self._odometry, self._stopped = link, odometry, stopped
        self._markers = zenoh_link.fifo_subscriber(session, f"{namespace}/sim/target/tick")
        self._credit = zenoh_link.blocking_publisher(session, f"{namespace}/sim/credit")
        self._marker_tick, self._marker_count, self._received = -1, 0, 0
        self._pool: list[RawSample] = []
        self._counts: dict[int, int] = {}
        self._last_ns = -1
        self.go_tick = NO_GO
        self.reply = b""  # frame of the last answer, for a vehicle that asks again
        self.target_gone = False

    def vehicle(self) -> int | None:
        """Return the simulated time of the next tick, ns; ``None`` if vehicle or process end."""
        link = self._link
        limit_s = FIRST_WAIT_MAX_S if self._last_ns < 0 else LOST_RUN_MAX_S
        until = time.monotonic() + limit_s
        while True:
            link.poll(max(0, self._last_ns) / 1e9)
            sim_ns: int | None = link.take_timesync()
            if sim_ns is not None and sim_ns != self._last_ns:
                self._last_ns = sim_ns
                return sim_ns
            if sim_ns is not None:
                link.endpoint.repeat(self.reply)
            if self._stopped() or time.monotonic() > until:
                return None
            link.endpoint.wait(WAIT_SLICE_S)

    def target(self, tick: int) -> list[RawSample]:
        """Samples that the target released up to this tick."""
        if tick % CREDIT_EVERY == 0:
            self._credit.put(PAIR.pack(tick, self.go_tick))
        until = time.monotonic() + (FIRST_WAIT_MAX_S if self._marker_tick < 0 else LATER_WAIT_MAX_S)
        repeat_at = time.monotonic() + WAIT_SLICE_S
        while not self.target_gone and not self._complete(tick):
            now = time.monotonic()
            if now > until or self._stopped():
                self.target_gone = True
            if now > repeat_at:
                self._credit.put(PAIR.pack(tick, self.go_tick))
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

    def announce_start(self, tick: int) -> None:
        """Tell the target when it may drive: after the last tick that it may already have computed."""
        self.go_tick = tick + RUN_AHEAD_TICKS + 1
        self._credit.put(PAIR.pack(tick, self.go_tick))
