"""Faults of the estimate on its way from the firmware to its autopilot.

On a Crazyflie that is a log stream over the radio: the firmware flies on by the good estimate, autopilot and
companion see the bad one.
"""

from __future__ import annotations

import math

from bridge.frames import Quat
from flightstack.core.types import Vec3
from sim.faults.samples import SampleFaults, Shape
from sim.faults.schedule import Running
from sim.firmware.estimator import INNOVATION_AGE_MAX_S
from sim.plant.sensors import NEVER_NS, NS
from sim.plant.vehicle_types import Estimate

PERIOD_NS = NS // 100  # the log stream's rate, 100 Hz


def turned(q: Quat, yaw_rad: float) -> Quat:
    """Attitude turned about the vertical."""
    c, s = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    w, x, y, z = q
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def _move(estimate: Estimate, offset: Vec3, turn: float) -> Estimate:
    x, y, z = estimate.position_enu_m
    moved = (x + offset[0], y + offset[1], z + offset[2])
    return estimate._replace(position_enu_m=moved, quaternion=turned(estimate.quaternion, turn))


SHAPE: Shape[Estimate] = Shape(_move, lambda first, _: first)


class OwnStateFaults:
    """What arrives of the estimate.

    Attributes:
        due_ns: when ``sample`` is to be called next.
    """

    def __init__(self) -> None:
        self._arrived_ns = 0
        self._reset()

    def _reset(self) -> None:
        self._samples = SampleFaults(SHAPE)
        self._arrived: Estimate | None = None
        self.due_ns = NEVER_NS

    def begin(self, running: Running) -> None:
        """A fault is on."""
        self._samples.begin(running)
        if self.due_ns == NEVER_NS:
            self.due_ns = running.start_ns

    def end(self, running: Running, now_ns: int) -> None:
        """It is over; after the last one the present estimate counts again, what was held is dropped."""
        self._samples.end(running, now_ns)
        if not self._samples.running:
            self._reset()

    def sample(self, now_ns: int, estimate: Estimate) -> None:
        """Put an estimate on its way."""
        self.due_ns += PERIOD_NS
        if self._arrived is None:
            self._arrived, self._arrived_ns = estimate, now_ns
        for arrived in self._samples.deliver(now_ns, [estimate]):
            self._arrived, self._arrived_ns = arrived, now_ns

    def report(self, now_ns: int, estimate: Estimate) -> Estimate:
        """What the autopilot has; invalid when nothing has come for as long as the estimator would bear.

        Args:
            now_ns: simulated time.
            estimate: what the firmware has.
        """
        arrived = self._arrived
        if arrived is None:
            return estimate
        fresh = (now_ns - self._arrived_ns) / NS < INNOVATION_AGE_MAX_S
        return arrived if fresh else arrived._replace(valid=False)
