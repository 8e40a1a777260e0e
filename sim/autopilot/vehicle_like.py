"""Interface between vehicle and simulated autopilot, and detection of standing by lasting contact."""

from __future__ import annotations

from typing import Protocol

from bridge.mavlink.server.telemetry import EstimateLike
from flightstack.core.types import Vec3


class CheckedEstimate(EstimateLike, Protocol):
    """State estimate of the on-board estimator."""

    @property
    def valid(self) -> bool:
        """Whether position and velocity are accurate enough for flight."""


class VehicleLike(Protocol):
    """The vehicle, for example ``sim.vehicle.vehicle.VehicleSim``.

    Methods return the reason of a rejection.
    """

    @property
    def battery_v(self) -> float: ...  # voltage of the single cell

    @property
    def armed(self) -> bool: ...

    @property
    def locked(self) -> bool: ...  # whether the firmware's supervisor has locked the motors until a restart

    @property
    def on_pad(self) -> bool: ...  # whether it touches the top of the pad

    @property
    def on_ground(self) -> bool: ...  # whether it touches the floor

    @property
    def landed(self) -> bool: ...  # whether it is at rest on a surface

    @property
    def motor_commands(self) -> tuple[float, float, float, float]:
        """Commands of the motors M1 to M4, 0 to 1 of the highest speed at the current voltage."""

    @property
    def duty(self) -> tuple[float, float, float, float]:
        """Duty cycles of the motors M1 to M4, 0 to 1."""

    def arm(self) -> str | None: ...

    def disarm(self, force: bool) -> str | None: ...

    def set_velocity(self, velocity_enu_m_s: Vec3, yaw_rad: float) -> None: ...

    def stop_setpoint(self) -> None:
        """Send a stop set-point to the firmware; it replaces the velocity set-point."""

    def estimate(self) -> CheckedEstimate: ...

    def reboot(self) -> str | None:
        """Restart the firmware, which also unlocks it; return the reason of a rejection."""

    def inject_failure(self, unit: int, kind: int, instance: int) -> str | None:
        """Inject a failure: numbers of FAILURE_UNIT and FAILURE_TYPE; instance 0 stands for all."""


_CONTACT_S = 0.3  # time of unbroken contact after which the vehicle counts as standing; bounces are shorter
_NO_CONTACT_S = 0.1  # time without contact after which it counts as flying


class Standing:
    def __init__(self, vehicle: VehicleLike) -> None:
        self._vehicle = vehicle
        self.now = vehicle.landed or vehicle.on_pad or vehicle.on_ground  # standing, not in brief contact
        self.since_s = 0.0  # start of the current state
        self._contact = self.now
        self._changed_s = 0.0

    @property
    def settled(self) -> bool:
        """Whether the newest contact reading agrees with ``now``."""
        return self._contact == self.now

    def watch(self, now_s: float, armed: bool) -> None:
        """Read the contacts; call it at every tick."""
        vehicle = self._vehicle
        contact = vehicle.on_pad or vehicle.on_ground or vehicle.landed
        if contact != self._contact:
            self._contact, self._changed_s = contact, now_s
        if contact == self.now:
            return
        lasted_s = now_s - self._changed_s
        if not armed or lasted_s >= (_CONTACT_S if contact else _NO_CONTACT_S) - 1e-9:
            self.now = contact or not armed
            self.since_s = now_s
