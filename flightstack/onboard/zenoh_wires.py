"""Zenoh connections of the onboard process: its session, the target's samples, and topics for ROS 2."""

from __future__ import annotations

from bridge.ros2.ros2_names import network
from bridge.target.ros2_target import Dialect, KeySearch, TargetSource, TargetSpec, TargetType
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import ConnectionAlarm
from flightstack.common.pacing import Tick
from flightstack.config.options import OnboardOptions
from flightstack.core.controller import Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.onboard.live_topics import LiveRos2
from logs.schema.rows import ControllerStepRow


class ZenohWires:
    """Owner of the Zenoh sessions.

    Raises ValueError: an endpoint, key, topic, domain or configuration is not valid; ZenohLinkError: a
    session cannot be opened.
    """

    def __init__(self, config: FlightConfig, options: OnboardOptions, namespace: str) -> None:
        self.target = target = TargetSpec.parse(
            options.target_key, TargetType(options.target_type), options.ros_domain, options.target_offset_m
        )
        self._lockstep, file = options.lockstep, options.zenoh_config
        if options.lockstep and not target.is_direct:
            raise ValueError(f"--target {target.text}: in lockstep it is a Zenoh key of the simulated target")
        # session of the flight
        self.session = zenoh_link.open_session(
            options.listen, options.connect, config_file=file, prompt=not options.lockstep,
            lockstep=options.lockstep,
        )  # fmt: skip
        role, whom = zenoh_link.dialled(options.connect, config_file=file)
        self._alarms = [ConnectionAlarm(self.session, whom, role)]
        self._sessions = [self.session]
        self._shown: LiveRos2 | None = None
        rate_hz, checks = config.loop.rate_hz, config.checks
        if (ros2 := network(options)) is not None:  # else a ROS 2 target uses the flight's session
            self._sessions.append(ros2.open())
            self._alarms.append(ConnectionAlarm(self._sessions[-1], [ros2.where], zenoh_link.Role.CLIENT))
            self._shown = LiveRos2(self._sessions[-1], ros2.domain, namespace, rate_hz)
        where = self.session if target.dialect is Dialect.PLAIN else self._sessions[-1]
        # samples of the target
        self.odometry = TargetSource(
            where, target, checks.target_frame, checks.target_child_frame, config.target,
            lossless=options.lockstep,
        )  # fmt: skip
        self.search = KeySearch(where)  # search for other keys of a target; idle until requested
        self._texts = [
            f"Zenoh listens on {endpoint} without rules: every process that reaches this endpoint "
            "can send a target (docs/how_to/zenoh.md)"
            for endpoint in zenoh_link.open_to_all(options.listen, config_file=file)
        ]

    def texts(self, now_s: float) -> list[str]:
        """Return the texts for the operator since the last call; in lockstep, none depends on wall time."""
        texts, self._texts = self._texts + self.odometry.take_problems(), []
        if not self._lockstep:
            for alarm in self._alarms:
                texts += alarm.poll(now_s)
        return texts

    def show(self, tick: Tick, out: Outputs, step: ControllerStepRow, health: bytes | None) -> None:
        """Publish a tick to ROS 2 if that is configured; the arguments are those of ``LiveRos2.show``."""
        if self._shown is not None:
            self._shown.show(tick, out, step, health)

    def close(self) -> None:
        """Close search, publishers and sessions."""
        self.search.stop()
        if self._shown is not None:
            self._shown.close()
        for session in reversed(self._sessions):
            session.close()
