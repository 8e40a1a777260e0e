"""The Zenoh side of the onboard process: its session, the target's motion, and the flight shown to ROS 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bridge.ros2.ros2_names import Ros2Network
from bridge.target.ros2_target import Dialect, KeySearch, TargetSource, TargetSpec
from bridge.zenoh import zenoh_link
from bridge.zenoh.zenoh_link import ConnectionAlarm
from flightstack.common.pacing import Tick
from flightstack.core.controller import Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.onboard.live_topics import LiveRos2
from logs.schema.rows import ControllerStepRow


@dataclass(frozen=True)
class ZenohPlan:
    """Where the process is plugged in."""

    target: TargetSpec  # target to follow
    connect: Sequence[str] = ()  # endpoints to dial
    listen: Sequence[str] = ()  # endpoints to listen on
    namespace: str = "cf1"  # first part of our keys and topics
    config_file: Path | None = None  # Zenoh configuration of the session of the flight
    # network of ROS 2 for a target that is a ROS 2 topic; None: such a target is on the session of the flight
    ros2: Ros2Network | None = None
    lockstep: bool = False  # lockstep with a simulated target


class ZenohWires:
    """Owns the sessions.

    Raises ValueError: an endpoint, key, topic, domain or configuration that is not understood;
    ZenohLinkError: a session that could not be opened.
    """

    def __init__(self, config: FlightConfig, plan: ZenohPlan) -> None:
        if plan.lockstep and not plan.target.is_direct:
            raise ValueError(
                f"--target {plan.target.text}: in lockstep it is a Zenoh key of the simulated target"
            )
        # session of the flight
        self.session = zenoh_link.open_session(
            plan.listen,
            plan.connect,
            config_file=plan.config_file,
            prompt=not plan.lockstep,
            lockstep=plan.lockstep,
        )
        role, whom = zenoh_link.dialled(plan.connect, config_file=plan.config_file)
        self._alarms = [ConnectionAlarm(self.session, whom, role)]
        self._sessions = [self.session]
        self._shown: LiveRos2 | None = None
        rate_hz, checks = config.loop.rate_hz, config.checks
        if plan.ros2 is not None:
            self._sessions.append(plan.ros2.open())
            self._alarms.append(
                ConnectionAlarm(self._sessions[-1], [plan.ros2.where], zenoh_link.Role.CLIENT)
            )
            self._shown = LiveRos2(self._sessions[-1], plan.ros2.domain, plan.namespace, rate_hz)
        where = self.session if plan.target.dialect is Dialect.PLAIN else self._sessions[-1]
        # samples of the target
        self.odometry = TargetSource(
            where, plan.target, checks.target_frame, checks.target_child_frame, config.target,
            lossless=plan.lockstep,
        )  # fmt: skip
        self.search = KeySearch(where)  # search for other keys of a target; idle until it is requested
        self._texts = [
            f"Zenoh listens on {endpoint} without rules: every process that reaches this endpoint "
            "can send a target (docs/how_to/zenoh.md)"
            for endpoint in zenoh_link.open_to_all(plan.listen, config_file=plan.config_file)
        ]
        self._lockstep, self.target = plan.lockstep, plan.target  # target of these samples

    def texts(self, now_s: float) -> list[str]:
        """What a person should know since the last call; in lockstep nothing that wall time has a part in."""
        texts, self._texts = self._texts + self.odometry.take_problems(), []
        if not self._lockstep:
            for alarm in self._alarms:
                texts += alarm.poll(now_s)
        return texts

    def show(self, tick: Tick, out: Outputs, step: ControllerStepRow, health: bytes | None) -> None:
        """Show a tick to ROS 2, if that is wanted; arguments as of ``LiveRos2.show``."""
        if self._shown is not None:
            self._shown.show(tick, out, step, health)

    def close(self) -> None:
        """Close everything."""
        self.search.stop()
        if self._shown is not None:
            self._shown.close()
        for session in reversed(self._sessions):
            session.close()
