"""Connects the simulated vehicle (MuJoCo, rotors, battery, attitude and velocity loop) to the firmware model.

Every scenario is flown with the firmware's filter (``sim.firmware.estimator``) and PID velocity loop. In
flight the filter uses only body z of the accelerometer, and the drag along x and y from ``kalman.dragB_*``.
"""

import math
from dataclasses import replace

import numpy as np

from bridge.frames import yaw_from_quaternion
from bridge.zenoh import zenoh_link
from sim.firmware.estimator import correct, correct_tilt
from sim.runners.published_robot import RealTimeDeck
from sim.scenarios.scenario import Scenario, load
from sim.scenarios.tables import VelocityLoop
from sim.vehicle.vehicle import VehicleSim, warm_up
from tests.crazyflie_firmware.plant import variance_m2

MS_MAX = 50  # maximum step, ms; during the rest of a longer pause simulated time stops


def take_pose(vehicle, position, quaternion):
    """Correct the estimate with an external pose: position, yaw, roll and pitch."""
    estimator = vehicle.record.firmware.estimator
    correct(estimator, *position, yaw_from_quaternion(quaternion))
    correct_tilt(estimator, np.array(quaternion))


class SimPlant:
    """A ``VehicleSim`` with the interface of ``plant.Point``; the pad follows the true pose of the robot.

    Only new set-points reach the vehicle, because the simulated firmware has a set-point watchdog of its own.

    ``session``: Zenoh session that receives the robot's pose in ``namespace``; None: the pad does not move;
    ``by_poses``: the vehicle receives external poses instead of the scenario's motion capture.
    """

    def __init__(
        self,
        scenario: str | Scenario,
        seed: int,
        session: zenoh_link.Session | None,
        namespace: str = "cf1",
        *,
        by_poses: bool = False,
    ) -> None:
        loaded = load(scenario) if isinstance(scenario, str) else scenario
        spec = replace(loaded.vehicle, known_drag_1_s=(0.0, 0.0, 0.0), velocity_loop=VelocityLoop.PID)
        if by_poses:
            spec = replace(spec, mocap=replace(spec.mocap, loss=1.0))
        loaded = replace(loaded, vehicle=spec)
        self._by_poses, self._posed_s = by_poses, -math.inf if by_poses else math.inf
        warm_up(loaded)
        self.vehicle = VehicleSim(loaded, seed)
        self._deck = RealTimeDeck(session, namespace) if session is not None else None
        self._pending: tuple | None = None
        self._yaw = self._yaw_rate = self._rest_s = self._now_s = 0.0

    @property
    def position(self):
        return self.vehicle.body().position_enu_m

    @property
    def true_quaternion(self):
        return self.vehicle.body().quaternion

    @property
    def estimate(self):
        believed = self.vehicle.estimate()
        return believed.position_enu_m, believed.velocity_enu_m_s

    @property
    def variance_m2(self) -> float:
        return variance_m2(max(0.0, self._now_s - self._posed_s))

    def pose(self, x: float, y: float, z: float, quaternion_xyzw) -> None:
        """Apply an external pose to the filter.

        A pose is ignored if it has no quaternion, or if the vehicle uses the scenario's motion capture.
        """
        if self._by_poses and quaternion_xyzw is not None:
            self._posed_s = self._now_s
            qx, qy, qz, qw = quaternion_xyzw
            take_pose(self.vehicle, (x, y, z), (qw, qx, qy, qz))

    def know_drag(self, drag_1_s) -> None:
        """Set the parameters ``kalman.dragB_*``."""
        self.vehicle.record.firmware.estimator.known_drag[:] = drag_1_s

    def reset(self, x: float, y: float, z: float, yaw: float) -> None:
        level = (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
        estimator = self.vehicle.firmware.estimator
        estimator.settle((x, y, z), (0.0, 0.0, 0.0), (0.0,) * 9, level, [0.0, 0.0, 0.0])

    def restart(self) -> None:
        self.motors_off()
        self.vehicle.reboot()

    @property
    def quaternion(self):
        return self.vehicle.estimate().quaternion

    @property
    def rates(self):
        return self.vehicle.estimate().angular_velocity_flu_rad_s

    @property
    def motors(self) -> bool:
        return self.vehicle.motors_running

    @property
    def on_surface(self) -> bool:
        return self.vehicle.on_pad or self.vehicle.on_ground

    def setpoint(self, velocity, yaw_rate: float) -> None:
        self._pending, self._yaw_rate = velocity, yaw_rate

    def command(self, velocity, yaw_rate: float, level: bool) -> None:
        vehicle = self.vehicle
        if not vehicle.armed and not vehicle.locked:
            vehicle.arm()
        if self._pending is not None and not level:
            vehicle.set_velocity(self._pending, self._yaw)
            self._pending = None

    def motors_off(self) -> None:
        self._pending, self._yaw_rate = None, 0.0
        if self.vehicle.armed:
            self.vehicle.stop_setpoint()
            self.vehicle.disarm(True)

    def advance(self, dt_s: float) -> None:
        self._now_s += dt_s
        # without thrust, the yaw set-point follows the yaw of the vehicle (controller_pid.c)
        if self.vehicle.armed:
            self._yaw += self._yaw_rate * dt_s
        else:
            self._yaw = yaw_from_quaternion(self.quaternion)
        self._rest_s += dt_s
        steps = min(int(self._rest_s * 1000.0), MS_MAX)
        self._rest_s -= steps / 1000.0
        if steps:
            self.vehicle.advance(steps)
            if self._deck is not None:
                self._deck.move(self.vehicle, self._now_s, lambda _: None, lambda _: None)
        self._rest_s = min(self._rest_s, 0.001 * MS_MAX)
