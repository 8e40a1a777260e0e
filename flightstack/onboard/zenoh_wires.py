"""Zenoh connections of the onboard process: its session, the target's samples, and topics for ROS 2."""

from __future__ import annotations

import math

from bridge.ros2.ros2_names import Ros2Node, Ros2Publisher, open_network
from bridge.target.ros2_target import Dialect, KeySearch, TargetSource, TargetSpec, TargetType
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import ConnectionAlarm
from flightstack.common.pacing import Tick
from flightstack.config.options import OnboardOptions
from flightstack.core.controller import Outputs
from flightstack.core.parameters.flight import FlightConfig
from logs.recorder.derive import Deriver
from logs.schema import schemas
from logs.schema.events import pack_string
from logs.schema.rows import ControllerStepRow

FLOAT64 = "std_msgs/msg/Float64"
PLAIN_HZ = 20.0  # rate of h, phase and controller/step, Hz; ``Deriver`` sets the rates of ``_DERIVED``
NODE = "flightstack_onboard"
_DERIVED = {
    "/pose": schemas.POSE_STAMPED,
    "/odom": schemas.ODOMETRY,
    "/target/pose": schemas.POSE_STAMPED,
    "/cmd/velocity_nominal": schemas.TWIST_STAMPED,
    "/cmd/velocity_filtered": schemas.TWIST_STAMPED,
    "/cmd/velocity": schemas.TWIST_STAMPED,
    "/cbf/markers": schemas.MARKER_ARRAY,
}


class ZenohWires:
    """Owner of the onboard process's Zenoh sessions; it receives the target and publishes to ROS 2."""

    def __init__(self, config: FlightConfig, options: OnboardOptions, namespace: str) -> None:
        self.target = target = TargetSpec.parse(
            options.target_key, TargetType(options.target_type), options.ros_domain, options.target_offset_m
        )
        self._lockstep, file = options.lockstep, options.zenoh_config
        if options.lockstep and not target.is_direct:
            raise ValueError(f"--target {target.text}: in lockstep it is a Zenoh key of the simulated target")
        # session for all data except ROS 2 topics
        self.session = zenoh_link.open_session(
            options.listen, options.connect, config_file=file, prompt=not options.lockstep,
            lockstep=options.lockstep,
        )  # fmt: skip
        role, whom = zenoh_link.dialled(options.connect, config_file=file)
        self._alarms = [ConnectionAlarm(self.session, whom, role)]
        self._sessions = [self.session]
        self._shown: LiveRos2 | None = None
        rate_hz, checks = config.loop.rate_hz, config.checks
        if (ros2 := options.ros2_where) is not None:  # None: a ROS 2 target uses the flight's session
            self._sessions.append(open_network(ros2, options.ros_domain))
            self._alarms.append(ConnectionAlarm(self._sessions[-1], [ros2], zenoh_link.Role.CLIENT))
            self._shown = LiveRos2(self._sessions[-1], options.ros_domain, namespace, rate_hz)
        where = self.session if target.dialect is Dialect.PLAIN else self._sessions[-1]
        # source of the target's samples
        self.odometry = TargetSource(
            where, target, checks.target_frame, checks.target_child_frame, config.target,
            lossless=options.lockstep,
        )  # fmt: skip
        self.search = KeySearch(where)  # search for other keys with target samples; it starts on request
        self._texts = [
            f"Zenoh listens on {endpoint} without rules: every process that reaches this endpoint "
            "can send a target (docs/how_to/zenoh.md)"
            for endpoint in zenoh_link.open_to_all(options.listen, config_file=file)
        ]

    def texts(self, now_s: float) -> list[str]:
        """Return the texts for the operator since the last call."""
        texts, self._texts = self._texts + self.odometry.take_problems(), []
        if not self._lockstep:  # the connection alarms depend on wall time
            for alarm in self._alarms:
                texts += alarm.poll(now_s)
        return texts

    def show(self, tick: Tick, out: Outputs, step: ControllerStepRow, health: bytes | None) -> None:
        """Publish a tick to ROS 2 if that is configured."""
        if self._shown is not None:
            self._shown.show(tick, out, step, health)

    def close(self) -> None:
        """Close search and sessions."""
        self.search.stop()
        for session in reversed(self._sessions):
            session.close()


class LiveRos2:
    """Publisher of one flight to ROS 2; its errors do not affect the flight. ``session`` remains open."""

    def __init__(self, session: zenoh_link.Session, domain: int, namespace: str, rate_hz: int) -> None:
        space = f"/{namespace}"
        self._node = Ros2Node(session, NODE, domain=domain, namespace=space)
        self._derive = Deriver(namespace)
        self._derived = {space + name: self._publisher(space + name, kind) for name, kind in _DERIVED.items()}
        self._derived["/tf"] = self._publisher("/tf", schemas.TF_MESSAGE)
        self._pack_float = schemas.packer(FLOAT64)
        self._h = self._publisher(space + "/h", FLOAT64)
        self._phase = self._publisher(space + "/phase", schemas.STRING)
        self._step = self._publisher(space + "/controller/step", schemas.CONTROLLER_STEP)
        self._health = self._publisher(space + "/health", schemas.HEALTH)
        self._every = max(1, round(rate_hz / PLAIN_HZ))

    def show(self, tick: Tick, out: Outputs, step: ControllerStepRow, health: bytes | None) -> None:
        """Publish the data due in this tick; ``step``: log row of ``out``; ``health``: None: not due."""
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

    def _publisher(self, topic: str, kind: str) -> Ros2Publisher:
        return self._node.publisher(topic, kind, schemas.type_hash(kind))
