"""``Watches.step`` of the autopilot in a batch of ticks, until a ground station is lost."""

from __future__ import annotations

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import scalars, writer
from flightstack.core.numeric import twin
from sim.autopilot import watches
from sim.autopilot.watches import PERIOD_S, Watches, WatchRecord
from sim.plant.rotors import speed_limit
from sim.vehicle.loop import VehicleRecord

_smoothed = twin(watches.smoothed, jitted)


@jitted
def looks(w: WatchRecord, v: VehicleRecord, now_s: float) -> bool:
    """Run the checks if they are due; if one may have a result, do nothing and return False."""
    if now_s < w.due_s:
        return True
    if now_s >= w.until_s:
        return False
    limit, total = speed_limit(v.battery), 0.0
    for command in v.firmware.commands:
        total += min(1.0, max(0.0, command / limit))
    dt_s = now_s - w.last_s
    voltage_v = _smoothed(w.voltage_v, v.battery.voltage_v, dt_s)
    throttle = _smoothed(w.throttle, total / 4.0, dt_s)
    w.last_s, w.due_s, w.voltage_v, w.throttle = now_s, now_s + PERIOD_S, voltage_v, throttle
    return True


class WatchBook:
    """Copies the state of the watches to a record and back."""

    def __init__(self, record: WatchRecord) -> None:
        self._write = writer(record)
        self._seen = scalars(record, "last_s", "voltage_v", "throttle")

    def write(self, of: Watches) -> None:
        """Copy the watches to the record."""
        self._write(*of.calm())

    def read(self, of: Watches) -> None:
        """Copy the record to the watches, if the checks have run."""
        last_s, voltage_v, throttle = (view[0] for view in self._seen)
        if last_s + PERIOD_S > of.due_s:
            of.passed(last_s, voltage_v, throttle)
