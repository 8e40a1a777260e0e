"""Interface of the vehicle to its simulated autopilot, and whether it stands (lasting contact, no bounce)."""

from __future__ import annotations

from typing import Protocol

from bridge.mavlink.server.telemetry import EstimateLike
from flightstack.core.types import Vec3


class CheckedEstimate(EstimateLike, Protocol):
    """State by the on-board estimator."""

    @property
    def valid(self) -> bool:
        """Whether position and velocity may be flown by."""


class VehicleLike(Protocol):
    """The vehicle; ``sim.vehicle.vehicle.VehicleSim`` is one. Methods that can refuse return the reason."""

    @property
    def battery_v(self) -> float: ...  # of the one cell

    @property
    def armed(self) -> bool: ...

    @property
    def locked(self) -> bool: ...  # the firmware's supervisor has locked the motors until a restart

    @property
    def on_pad(self) -> bool: ...  # in contact with the top of the pad

    @property
    def on_ground(self) -> bool: ...  # in contact with the ground

    @property
    def landed(self) -> bool: ...  # at rest on something

    @property
    def motor_commands(self) -> tuple[float, float, float, float]:
        """Commands of the motors M1 to M4, 0 to 1 of the highest speed at the present voltage."""

    @property
    def duty(self) -> tuple[float, float, float, float]:
        """Duty cycles of the motors M1 to M4, 0 to 1."""

    def arm(self) -> str | None: ...

    def disarm(self, force: bool) -> str | None: ...

    def set_velocity(self, velocity_enu_m_s: Vec3, yaw_rad: float) -> None: ...

    def stop_setpoint(self) -> None:
        """Notify the firmware that no set-point is active any more."""

    def estimate(self) -> CheckedEstimate: ...

    def reboot(self) -> str | None:
        """Restart the firmware, which also unlocks it."""

    def inject_failure(self, unit: int, kind: int, instance: int) -> str | None:
        """Let something fail: numbers of FAILURE_UNIT and FAILURE_TYPE, instance 0 for all."""


_CONTACT_S = 0.3  # s of unbroken contact until the vehicle counts as standing; bounces are shorter
_NO_CONTACT_S = 0.1  # s without contact until it counts as flying again


class Standing:
    def __init__(self, vehicle: VehicleLike) -> None:
        self._vehicle = vehicle
        self.now = vehicle.landed or vehicle.on_pad or vehicle.on_ground  # not just touching
        self.since_s = 0.0  # when that began
        self._contact = self.now
        self._changed_s = 0.0

    @property
    def settled(self) -> bool:
        """Whether the newest contact agrees with ``now``."""
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
