"""What the onboard process writes into the log and shows to the world: its inputs, steps, timing, events."""

from __future__ import annotations

import math
from typing import Protocol

from bridge import zenoh_link
from bridge.mavlink import Direction, Peer
from bridge.odometry import RawSample
from flightstack.controller import Outputs
from flightstack.pacing import Tick
from flightstack.types import ZERO
from logs.codec import (
    ControllerStepRow,
    LoopTimingRow,
    pack_controller_step,
    pack_log,
    pack_loop_timing,
    pack_mavlink,
)

STATUS_HZ = 20.0  # of the live topics
TIMESYNC_ID = 111  # low byte of the message id, which is at offset 7 of a MAVLink 2 frame


class FeedLike(Protocol):
    """The recorder's feed, or one that goes nowhere."""

    def channel(self, topic: str, schema: str) -> int:
        """Declare a channel."""

    def write(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
    ) -> None:
        """Queue a message."""

    def flush(self) -> None:
        """Send what is queued."""


class OnboardLog:
    """Turns one tick into log messages, and every so often into live ones."""

    def __init__(
        self, feed: FeedLike, session: zenoh_link.Session, namespace: str, rate_hz: int, lockstep: bool
    ) -> None:
        self._feed = feed
        self._odom = feed.channel(f"/{namespace}/target/odom", "nav_msgs/msg/Odometry")
        self._mavlink = {
            Direction.IN: feed.channel("/uas1/mavlink_source", "mavros_msgs/msg/Mavlink"),
            Direction.OUT: feed.channel("/uas1/mavlink_sink", "mavros_msgs/msg/Mavlink"),
        }
        self._step = feed.channel(f"/{namespace}/controller/step", "flightstack_msgs/msg/ControllerStep")
        self._timing = feed.channel(f"/{namespace}/loop/timing", "flightstack_msgs/msg/LoopTiming")
        self._rosout = feed.channel("/rosout", "rcl_interfaces/msg/Log")
        self._frames: list[tuple[Direction, bytes]] = []
        self._asked = b""  # last TIMESYNC that came
        self._sequence = 0
        self._flush_every = 10 if lockstep else 1  # ticks; fewer wake-ups of the recorder, 0.1 s of flight
        self._every = max(1, round(rate_hz / STATUS_HZ))
        encoding = "application/cdr;flightstack_msgs/msg/"
        self._live_step = zenoh_link.dropping_publisher(
            session, f"{namespace}/controller/step", encoding + "ControllerStep"
        )
        self._live_timing = zenoh_link.dropping_publisher(
            session, f"{namespace}/loop/timing", encoding + "LoopTiming"
        )

    def tap(self, direction: Direction, frame: bytes, peer: Peer) -> None:
        """Keep a MAVLink frame until its tick is known; the endpoint's tap."""
        del peer
        if direction is Direction.IN and frame[7] == TIMESYNC_ID:
            if frame == self._asked:
                return  # a repeated question of lockstep, the same to the byte: a matter of wall time
            self._asked = frame
        self._frames.append((direction, frame))

    def samples(self, samples: list[RawSample], unix_ns: int) -> None:
        """Write target samples verbatim, accepted or not."""
        for sample in samples:
            source_ns = sample.source_time_ns if sample.source_time_ns is not None else unix_ns
            self._feed.write(
                self._odom, unix_ns, source_ns, (sample.sequence or 0) & 0xFFFFFFFF, sample.payload
            )

    def event(self, unix_ns: int, level: int, text: str) -> None:
        """Write an event of /rosout."""
        self._feed.write(self._rosout, unix_ns, unix_ns, 0, pack_log(unix_ns, level, "onboard", text))

    def step(self, tick: Tick, out: Outputs) -> bytes:
        """Write the frames, events and decisions of a tick; the step's message is returned."""
        unix_ns = tick.unix_ns
        frames, self._frames = self._frames, []
        for direction, frame in frames:
            self._sequence += 1
            self._feed.write(
                self._mavlink[direction], unix_ns, unix_ns, self._sequence, pack_mavlink(unix_ns, frame)
            )
        for event in out.events:
            self.event(unix_ns, event.level, event.text)
        payload = pack_controller_step(_row(tick, out))
        self._feed.write(self._step, unix_ns, unix_ns, tick.number, payload)
        return payload

    def timing(
        self, tick: Tick, out: Outputs, exec_s: float, overruns: int, dropped: int, step: bytes
    ) -> None:
        """Write how the wall clock kept the tick; show both to live subscribers now and then."""
        solve_s = out.barrier.result.solve_s if out.barrier is not None else 0.0
        row = LoopTimingRow(
            tick.unix_ns, tick.number, tick.period_s, tick.lateness_s, exec_s, solve_s, overruns, dropped
        )
        payload = pack_loop_timing(row)
        self._feed.write(self._timing, tick.unix_ns, tick.unix_ns, tick.number, payload)
        if tick.number % self._every == 0:
            self._live_step.put(step)
            self._live_timing.put(payload)
        if tick.number % self._flush_every == 0:
            self._feed.flush()


def _row(tick: Tick, out: Outputs) -> ControllerStepRow:
    """Values that are not there are NaN; zero would be a claim."""
    own, target, barrier, seen = out.seen.inputs.own, out.seen.target, out.barrier, out.seen
    nan = math.nan
    none = (nan, nan, nan)
    return ControllerStepRow(
        stamp_ns=tick.unix_ns,
        tick=tick.number,
        phase=out.phase,
        request=out.request,
        filter_status=barrier.result.status if barrier is not None else 0,
        gate=out.gate,
        setpoint_sent=out.setpoint is not None,
        barrier_active=barrier.result.active if barrier is not None else False,
        own_valid=seen.own_ok,
        target_valid=seen.target_ok,
        own_age_s=tick.now_s - own.arrival_s if own is not None else nan,
        target_age_s=target.age_s if target is not None else nan,
        own_position_enu_m=own.position_enu_m if own is not None else none,
        own_velocity_enu_m_s=own.velocity_enu_m_s if own is not None else none,
        own_yaw_rad=own.yaw_rad if own is not None else nan,
        target_position_enu_m=target.position_enu_m if target is not None else none,
        target_velocity_enu_m_s=target.velocity_enu_m_s if target is not None else none,
        target_yaw_rad=target.yaw_rad if target is not None else nan,
        h_m=barrier.h_m if barrier is not None else nan,
        gradient=barrier.gradient if barrier is not None else none,
        dh_dt_m_s=barrier.dh_dt_m_s if barrier is not None else nan,
        nominal_enu_m_s=barrier.nominal if barrier is not None else none,
        filtered_enu_m_s=barrier.result.velocity_enu_m_s if barrier is not None else none,
        command_enu_m_s=out.setpoint.velocity_enu_m_s if out.setpoint is not None else ZERO,
        slack_m_s=barrier.result.slack_m_s if barrier is not None else nan,
        residual=barrier.result.residual_m_s if barrier is not None else nan,
        iterations=barrier.result.iterations if barrier is not None else 0,
        target_accepted=out.target_accepted,
        target_rejected=out.target_rejected,
    )
