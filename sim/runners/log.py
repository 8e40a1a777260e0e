"""Log entries of the simulator: events, true states of the vehicle and of the deck."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from logs.recorder.feed import Feed
from logs.schema import schemas
from logs.schema.events import ContactBit, Severity, pack_log
from logs.schema.names import OWN, Names
from logs.schema.rows import TrueStateRow
from sim.plant.vehicle_types import Truth

_LEVELS: dict[int, Severity] = {
    dialect.MAV_SEVERITY_EMERGENCY: Severity.FATAL,
    dialect.MAV_SEVERITY_ALERT: Severity.FATAL,
    dialect.MAV_SEVERITY_CRITICAL: Severity.ERROR,
    dialect.MAV_SEVERITY_ERROR: Severity.ERROR,
    dialect.MAV_SEVERITY_WARNING: Severity.WARN,
    dialect.MAV_SEVERITY_NOTICE: Severity.INFO,
    dialect.MAV_SEVERITY_INFO: Severity.INFO,
    dialect.MAV_SEVERITY_DEBUG: Severity.DEBUG,
}
_CONTACTS = {
    ContactBit.PAD.value: (Severity.INFO, "contact with the pad"),
    ContactBit.GROUND.value: (Severity.INFO, "contact with the ground"),
    ContactBit.ROBOT.value: (Severity.WARN, "contact with the robot's body"),
    ContactBit.PAD_EDGE.value: (Severity.WARN, "contact with the pad's edge"),
    ContactBit.TUMBLED.value: (Severity.ERROR, "tumbled"),
    ContactBit.VEHICLE.value: (Severity.ERROR, "collision with another vehicle"),
}
_CONTACT_GAP_S = 0.5  # time without contact after which the next contact is a new event


class EventLog:
    """Writes ``/rosout`` of one process."""

    def __init__(self, feed: Feed, name: str, epoch_ns: int) -> None:
        self.feed = feed
        self.epoch_ns = epoch_ns
        self._name = name
        self._channel = feed.channel("/rosout", schemas.LOG)
        self._sequence = 0

    def event(self, now_ns: int, level: int, text: str) -> None:
        """Write one event; ``now_ns``: time since the epoch."""
        stamp_ns = self.epoch_ns + now_ns
        self._sequence += 1
        payload = pack_log(stamp_ns, level, self._name, text)
        self.feed.write(self._channel, stamp_ns, stamp_ns, self._sequence, payload)

    def statustext(self, now_ns: int, severity: int, text: str) -> None:
        """Write a status text of the autopilot."""
        self.event(now_ns, _LEVELS.get(severity, Severity.INFO), text)


class VehicleLog(EventLog):
    """Events, true state and the deck's true state of the vehicle process."""

    def __init__(self, feed: Feed, epoch_ns: int, namespace: str = "cf1", names: Names = OWN) -> None:
        super().__init__(feed, names.logger("vehicle"), epoch_ns)
        self._truth = feed.channel(f"/{namespace}/sim/truth", schemas.TRUE_STATE)
        self._target = feed.channel(f"/{namespace}/sim/target/truth", schemas.ODOMETRY)
        self._contact_s: dict[int, float] = {}
        self._targets = 0

    def truth(self, tick: int, now_ns: int, truth: Truth) -> None:
        """Write the true state, and new contacts as events."""
        stamp_ns = self.epoch_ns + now_ns
        w, x, y, z = truth.quaternion
        row = TrueStateRow(
            stamp_ns, tick, truth.position_enu_m, truth.velocity_enu_m_s, (x, y, z, w),
            truth.angular_velocity_flu_rad_s, truth.rotor_rpm, truth.pad_position_enu_m,
            truth.pad_velocity_enu_m_s, truth.pad_yaw_rad, truth.h_m, truth.h_min_m,
            truth.h_min_outside_pad_m, truth.contacts, truth.first_touch_relative_position_enu_m,
            truth.first_touch_relative_velocity_enu_m_s, truth.first_touch_time_s, truth.motors_running,
            truth.battery_v, truth.wind_enu_m_s,
        )  # fmt: skip
        self.feed.write(self._truth, stamp_ns, stamp_ns, tick, row.pack())
        if truth.contacts:
            self._contacts(now_ns, truth.contacts)

    def target(self, now_ns: int, payload: bytes) -> None:
        """Write the deck's true state, unchanged."""
        stamp_ns = self.epoch_ns + now_ns
        self._targets += 1
        self.feed.write(self._target, stamp_ns, stamp_ns, self._targets, payload)

    def _contacts(self, now_ns: int, contacts: int) -> None:
        now_s = now_ns * 1e-9
        for bit, (level, text) in _CONTACTS.items():
            if contacts & bit:
                last_s = self._contact_s.get(bit)
                if last_s is None or now_s - last_s > _CONTACT_GAP_S:
                    self.event(now_ns, level, text)
                self._contact_s[bit] = now_s
