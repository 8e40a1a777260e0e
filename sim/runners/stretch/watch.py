"""The autopilot's slow fail-safes in a stretch: they look as ``Watches.step`` does, and find nothing."""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import scalars, writer
from flightstack.core.numeric import twin
from flightstack.core.types import Vec3
from sim.autopilot import watches
from sim.autopilot.watches import PERIOD_S, Watches, WatchRecord
from sim.plant.rotors import speed_limit
from sim.vehicle.loop import VehicleRecord

_NEAR = 0.9  # share of the fence from which on Python decides
_smoothed, _charge_left = twin(watches.smoothed, jitted), twin(watches.charge_left, jitted)


@jitted
def _within(w: WatchRecord, v: VehicleRecord) -> bool:
    """Whether the estimate is well inside the fence."""
    p, home = v.firmware.estimator.sensed.position, w.home
    x, y, z = p[0] - home[0], p[1] - home[1], p[2] - home[2]
    return bool(math.sqrt(x * x + y * y) < _NEAR * w.reach_m and z < _NEAR * w.height_m)


@jitted
def looks(w: WatchRecord, v: VehicleRecord, now_s: float) -> bool:
    """Look, if it is time; False, and nothing done, where there may be something to be found."""
    if now_s < w.due_s:
        return True
    if not (now_s < w.until_s and _within(w, v)):
        return False
    limit, total = speed_limit(v.battery), 0.0
    for command in v.firmware.commands:
        total += min(1.0, max(0.0, command / limit))
    dt_s = now_s - w.last_s
    voltage_v = _smoothed(w.voltage_v, v.battery.voltage_v, dt_s)
    throttle = _smoothed(w.throttle, total / 4.0, dt_s)
    if not _charge_left(voltage_v, throttle, w.empty_v, w.full_v, w.drop_v) >= w.least:
        return False
    w.last_s, w.due_s, w.voltage_v, w.throttle = now_s, now_s + PERIOD_S, voltage_v, throttle
    return True


class WatchBook:
    """Writes what the watches need into a record, and what they saw back."""

    def __init__(self, record: WatchRecord) -> None:
        self._write = writer(record)
        self._seen = scalars(record, "last_s", "voltage_v", "throttle")

    def write(self, of: Watches, home_enu_m: Vec3) -> None:
        """Watches to record."""
        self._write(*of.calm(home_enu_m))

    def read(self, of: Watches) -> None:
        """Record to watches, if they have looked."""
        last_s, voltage_v, throttle = (view[0] for view in self._seen)
        if last_s + PERIOD_S > of.due_s:
            of.passed(last_s, voltage_v, throttle)
