"""Data that a flight publishes live: its health on Zenoh, and the topics of the log to ROS 2.

``LiveRos2`` is a node of rmw_zenoh with its own session, so the ROS 2 side cannot disturb the connections
that the flight depends on.
"""

from __future__ import annotations

import math

from bridge.mavlink.client.vehicle_state import Battery
from bridge.ros2.ros2_names import Ros2Node, Ros2Publisher
from bridge.zenoh.zenoh_link import Session
from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from logs.derive.derive import STEP_SUFFIX, Deriver
from logs.schema.events import pack_string
from logs.schema.rows import ControllerStepRow, HealthRow
from logs.schema.schemas import (
    CONTROLLER_STEP,
    HEALTH,
    MARKER_ARRAY,
    ODOMETRY,
    POSE_STAMPED,
    STRING,
    TF_MESSAGE,
    TWIST_STAMPED,
    packer,
    type_hash,
)

BATTERY_AGE_MAX_S = 5.0  # longest age of a voltage: SYS_STATUS arrives at least once a second
FLOAT64 = "std_msgs/msg/Float64"
PLAIN_HZ = 20.0  # rate of the topics h, phase and step; viewer topics have their own rates
NODE = "flightstack_onboard"
_DERIVED = {
    "/pose": POSE_STAMPED,
    "/odom": ODOMETRY,
    "/target/pose": POSE_STAMPED,
    "/cmd/velocity_nominal": TWIST_STAMPED,
    "/cmd/velocity_filtered": TWIST_STAMPED,
    "/cmd/velocity": TWIST_STAMPED,
    "/cbf/markers": MARKER_ARRAY,
}


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


class LiveRos2:
    """Publisher of one flight to ROS 2; the flight does not depend on it.

    ``session``: session that reaches the ROS 2 nodes; the caller closes it; ``domain``: their ROS_DOMAIN_ID;
    ``namespace``: first part of the topics; ``rate_hz``: rate of the ticks.
    Raises ValueError: a namespace or domain that ROS 2 does not allow.
    """

    def __init__(self, session: Session, domain: int, namespace: str, rate_hz: int) -> None:
        space = f"/{namespace}"
        self._node = Ros2Node(session, NODE, domain=domain, namespace=space)
        self._derive = Deriver(space + STEP_SUFFIX)
        self._derived = {space + name: self._publisher(space + name, kind) for name, kind in _DERIVED.items()}
        self._derived["/tf"] = self._publisher("/tf", TF_MESSAGE)
        self._pack_float = packer(FLOAT64)
        self._h = self._publisher(space + "/h", FLOAT64)
        self._phase = self._publisher(space + "/phase", STRING)
        self._step = self._publisher(space + STEP_SUFFIX, CONTROLLER_STEP)
        self._health = self._publisher(space + "/health", HEALTH)
        self._every = max(1, round(rate_hz / PLAIN_HZ))

    def show(self, tick: Tick, out: Outputs, step: ControllerStepRow, health: bytes | None) -> None:
        """Publish the data that is due in this tick.

        ``out``: outputs of the tick; ``step``: the same outputs as a row of the log; ``health``: serialised
        health, if it is due.
        """
        now_ns = tick.unix_ns
        for topic, _, payload in self._derive.step(now_ns, step):
            publisher = self._derived.get(topic)
            if publisher is not None:
                publisher.put(payload, now_ns)
        if health is not None:
            self._health.put(health, now_ns)
        if tick.number % self._every == 0 or out.finished:
            h_m = out.barrier.h_m if out.barrier is not None else math.nan
            self._h.put(self._pack_float((h_m,)), now_ns)
            self._phase.put(pack_string(out.phase.name), now_ns)
            self._step.put(step.pack(), now_ns)

    def close(self) -> None:
        """Leave the ROS 2 graph."""
        self._node.close()

    def _publisher(self, topic: str, kind: str) -> Ros2Publisher:
        return self._node.publisher(topic, kind, type_hash(kind))
