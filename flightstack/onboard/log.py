"""Log of the onboard process: its inputs, steps, timing and events, and the live topics."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bridge.mavlink.client.vehicle_state import Battery
from bridge.mavlink.endpoint import Direction
from bridge.mavlink.transport.address import Peer
from bridge.target.odometry import RawSample
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import Tick
from flightstack.core.controller import Controller, Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.onboard.fleet_wire import KEY, NEIGHBOURS
from flightstack.onboard.runner import Taken
from flightstack.onboard.state_text import state_text
from logs.recorder.feed import Feed
from logs.schema import Names, schemas
from logs.schema.controller_rows import (
    TickInputs,
    pack_controller_input,
    pack_neighbours,
    power_row,
    step_row,
)
from logs.schema.events import CONTROLLER, ONBOARD, pack_log
from logs.schema.mavlink import MAVLINK_PEERS, PeerNames, pack_mavlink
from logs.schema.rows import ControllerStateRow, ControllerStepRow, HealthRow, LoopTimingRow

STATUS_HZ = 20.0  # rate of the live topics for steps and timing, Hz
HEALTH_HZ = 5.0  # rate of the live topic for the health, Hz
BATTERY_AGE_MAX_S = 5.0  # maximum age of a battery voltage, s; SYS_STATUS arrives at least once a second
STATE_HZ = 1.0  # rate of the recorded controller states, which a replay compares, Hz
TIMESYNC_ID = 111  # low byte of TIMESYNC's message id, at offset 7 of a MAVLink 2 frame


class OnboardLog:
    """Writer of each tick's log messages, and publisher of the live topics at lower rates."""

    def __init__(
        self, feed: Feed, session: zenoh_link.Session, names: Names, config: FlightConfig,
        of_fleet: Sequence[tuple[str, str]] = (), *, lockstep: bool,
    ) -> None:  # fmt: skip
        """Open the channels.

        ``session``: Zenoh session of the live topics; ``names``: names of channels, topics and metadata;
        ``of_fleet``: topics of the fleet's messages, with their types.
        """
        self._feed, self._names, self._lockstep = feed, names, lockstep

        def topic(name: str, schema: str) -> int:
            return feed.channel(f"/{names.member}/{name}", schema)

        def live(name: str, kind: str) -> zenoh_link.Publisher:
            encoding = f"application/cdr;flightstack_msgs/msg/{kind}"
            return zenoh_link.dropping_publisher(session, f"{names.member}/{name}", encoding)

        def every(rate_hz: float) -> int:
            return max(1, round(config.loop.rate_hz / rate_hz))

        self._odom = topic("target/odom", schemas.ODOMETRY)
        self._mavlink = {
            Direction.IN: feed.channel(names.frames("mavlink_source"), schemas.MAVLINK),
            Direction.OUT: feed.channel(names.frames("mavlink_sink"), schemas.MAVLINK),
        }
        self._input = topic("controller/input", schemas.CONTROLLER_INPUT)
        self._step = topic("controller/step", schemas.CONTROLLER_STEP)
        self._power = None
        if config.reserve is not None:
            self._power = topic("controller/power", schemas.CONTROLLER_POWER)
        self._of_fleet = {name: topic(name, schema) for name, schema in of_fleet}
        self._state = topic("controller/state", schemas.CONTROLLER_STATE)
        self._timing = topic("loop/timing", schemas.LOOP_TIMING)
        self._rosout = feed.channel("/rosout", schemas.LOG)
        self._frames: list[tuple[Direction, bytes, str]] = []  # direction, frame, name of the peer
        self._peer_names = PeerNames(feed.metadata, names.record(MAVLINK_PEERS))
        self._asked = b""  # newest TIMESYNC request from the vehicle
        self._sequence = self._unix_ns = 0
        self._flush_every = 10 if lockstep else 1  # ticks between flushes; with 10 the recorder wakes less
        self._every, self._state_every, self._health_every = map(every, (STATUS_HZ, STATE_HZ, HEALTH_HZ))
        self._state_text = state_text(config)
        self._live_step = live("controller/step", "ControllerStep")
        self._live_timing = live("loop/timing", "LoopTiming")
        self._live_health = live("health", "Health")

    def _put(self, channel: int, tick: Tick, payload: bytes) -> None:
        self._feed.write(channel, tick.unix_ns, tick.unix_ns, tick.number, payload)

    def tap(self, direction: Direction, frame: bytes, peer: Peer) -> None:
        """Store a MAVLink frame until its tick is known; the endpoint calls this method."""
        if self._lockstep and direction is Direction.IN and frame[7] == TIMESYNC_ID:
            if frame == self._asked:
                return  # a repeated request with equal bytes is not logged: repeats depend on wall time
            self._asked = frame
        self._frames.append((direction, frame, self._peer_names(peer)))

    def samples(self, samples: Sequence[RawSample], unix_ns: int) -> None:
        """Write target samples unchanged, also rejected ones."""
        for sample in samples:
            source_ns = sample.source_time_ns if sample.source_time_ns is not None else unix_ns
            self._feed.write(
                self._odom, unix_ns, source_ns, (sample.sequence or 0) & 0xFFFFFFFF, sample.payload
            )

    def event(self, unix_ns: int, level: int, text: str, name: str = ONBOARD) -> None:
        """Write an event to the topic /rosout."""
        self._feed.write(
            self._rosout, unix_ns, unix_ns, 0, pack_log(unix_ns, level, self._names.logger(name), text)
        )

    def frames(self) -> None:
        """Write the frames that were stored since the last call, with the time of the newest tick."""
        frames, self._frames, unix_ns = self._frames, [], self._unix_ns
        for direction, frame, peer in frames:
            self._sequence += 1
            self._feed.write(
                self._mavlink[direction], unix_ns, unix_ns, self._sequence, pack_mavlink(unix_ns, frame, peer)
            )

    def end(self) -> None:
        """Write the frames that were sent after the newest tick, with the time of this tick plus 1 ns."""
        self._unix_ns += 1
        self.frames()

    def step(self, tick: Tick, taken: Taken, out: Outputs, controller: Controller) -> ControllerStepRow:
        """Write frames, inputs, events and outputs of a tick, once a second the state; return its row."""
        unix_ns = self._unix_ns = tick.unix_ns
        self.frames()
        given = TickInputs(unix_ns, tick.number, tick.now_s, taken.inputs, taken.command_failed)
        self._put(self._input, tick, pack_controller_input(given))
        if self._power is not None:
            self._put(self._power, tick, power_row(tick, taken.inputs.power, out.reserve).pack())
        if NEIGHBOURS in self._of_fleet:
            self._put(self._of_fleet[NEIGHBOURS], tick, pack_neighbours(tick, taken.inputs.neighbours))
        for event in out.events:
            self.event(unix_ns, event.level, event.text, CONTROLLER)
        row = step_row(tick, out)
        self._packed_step = row.pack()
        self._put(self._step, tick, self._packed_step)
        if tick.number % self._state_every == 0:
            text = self._state_text
            snapshot = ControllerStateRow(unix_ns, tick.number, text.layout, text.dumps(controller.state))
            self._put(self._state, tick, snapshot.pack())
        return row

    def status(self, tick: Tick, payload: bytes | None) -> None:
        """Write this vehicle's status as it was sent to its fleet; None: it was not sent."""
        if payload is not None:
            self._put(self._of_fleet[KEY], tick, payload)

    def health(
        self, tick: Tick, out: Outputs, reason: str, battery: Battery | None, dropped: int
    ) -> bytes | None:
        """Publish the health at ``HEALTH_HZ`` and at the end, but do not log it; None: not due."""
        if tick.number % self._health_every != 0 and not out.finished:
            return None
        payload = health_row(tick, out, reason, battery, dropped).pack()
        self._live_health.put(payload)
        return payload

    def timing(self, tick: Tick, out: Outputs, exec_s: float, dropped: int) -> None:
        """Write the timing of the tick; publish it and the last step at ``STATUS_HZ``."""
        solve_s = out.barrier.result.solve_s if out.barrier is not None else 0.0
        payload = LoopTimingRow(
            tick.unix_ns, tick.number, tick.period_s, tick.lateness_s, exec_s, solve_s, tick.overruns, dropped
        ).pack()
        self._put(self._timing, tick, payload)
        if tick.number % self._every == 0 or out.finished:
            self._live_step.put(self._packed_step)
            self._live_timing.put(payload)
        if tick.number % self._flush_every == 0:
            self._feed.flush()


def health_row(tick: Tick, out: Outputs, reason: str, battery: Battery | None, dropped: int) -> HealthRow:
    """Return the health of a tick; values that are missing or too old are NaN."""
    own, status, target = out.snapshot.inputs.own, out.snapshot.inputs.status, out.snapshot.target
    if battery is not None and tick.now_s - battery.arrival_s > BATTERY_AGE_MAX_S:
        battery = None
    return HealthRow(
        stamp_ns=tick.unix_ns,
        tick=tick.number,
        own_age_s=tick.now_s - own.arrival_s if own is not None else math.nan,
        target_age_s=target.age_s if target is not None else math.nan,
        link_age_s=tick.now_s - status.arrival_s if status is not None else math.nan,
        battery_v=_known(battery.voltage_v if battery is not None else None),
        battery_share=_known(battery.share if battery is not None else None),
        mode=status.mode if status is not None else 0,
        landed=status.landed if status is not None else 0,
        armed=status.armed if status is not None else False,
        ready_to_arm=status.ready_to_arm if status is not None else False,
        own_valid=out.snapshot.own_ok,
        target_valid=out.snapshot.target_ok,
        link_valid=out.snapshot.link_ok,
        finished=out.finished,
        target_accepted=out.target_accepted,
        target_rejected=out.target_rejected,
        overruns=tick.overruns,
        feed_dropped=dropped,
        reason=reason,
    )


def _known(value: float | None) -> float:
    return math.nan if value is None else value
