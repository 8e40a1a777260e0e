"""Whether the vehicle stands: contact that lasts, not a bounce."""

from __future__ import annotations

from sim.autopilot.vehicle_like import VehicleLike

_CONTACT_S = 0.3  # s of unbroken contact until the vehicle counts as standing; bounces are shorter
_NO_CONTACT_S = 0.1  # s without contact until it counts as flying again


class Standing:
    """Watches the contacts.

    Attributes:
        now: on the ground or on the pad, not just touching.
        since_s: when that began.
    """

    def __init__(self, vehicle: VehicleLike) -> None:
        self._vehicle = vehicle
        self.now = vehicle.landed or vehicle.on_pad or vehicle.on_ground
        self.since_s = 0.0
        self._contact = self.now
        self._changed_s = 0.0

    def watch(self, now_s: float, armed: bool) -> None:
        """Look at the contacts; call it at every tick."""
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
