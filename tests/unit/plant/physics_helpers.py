"""A simulated vehicle taken apart: plant alone, or with ideal sensors."""

import numpy as np

from sim.scenarios.scenario import OdometryLink, VehicleSpec
from sim.vehicle.loop import push
from sim.world.step import physics_step
from tests.unit.vehicle.vehicle_sim_helpers import vehicle

PROMPT = OdometryLink(100.0)  # motion capture without noise and delay
HIGH_M = 1000.0


def quiet_vehicle(slow=False, **parts):
    """A hovering vehicle without noise, biases and delays."""
    sim = vehicle(vehicle=VehicleSpec(mocap=PROMPT, slow_motors=slow, setpoint_delay_s=0.0), **parts)
    imu = sim._imu.record
    imu.gyro_sigma = imu.accel_sigma = 0.0
    imu.gyro_bias[:] = imu.accel_bias[:] = 0.0
    sim._imu.accel_bias = [0.0, 0.0, 0.0]
    sim._settle()
    return sim


class FreePlant:
    """Body and rotors high above everything, rotor commands prescribed.

    Attributes:
        record: of the vehicle; drag, rotor maps and so on may be changed before the first step.
    """

    def __init__(self, slow=False, **parts):
        self.sim = quiet_vehicle(slow, **parts)
        self.record = self.sim._vehicle[0]
        self.place()
        self.rotors(0.0)

    def place(self, quaternion=(1.0, 0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
        """Put it ``HIGH_M`` above the origin."""
        q = np.array(quaternion) / np.linalg.norm(quaternion)
        self.sim._world.set_vehicle((0.0, 0.0, HIGH_M), tuple(q.tolist()), velocity, rates)

    def rotors(self, rpm):
        """Let them turn at this speed, and go on so."""
        self.record.rotors.rpm[:] = rpm
        self.record.firmware.commands[:] = rpm

    def no_drag(self):
        """Take the rotors' drag on the body away."""
        self.record.drag.xy = self.record.drag.along = 0.0

    def run(self, steps, command=None):
        """Move by so many milliseconds under a command in rpm."""
        if command is not None:
            self.record.firmware.commands[:] = command
        for _ in range(steps):
            push(self.record)
            assert physics_step(self.record.world)

    @property
    def state(self):
        """Position, velocity, quaternion, rates, rotor speeds: 17 numbers."""
        w = self.sim._world
        return np.array([*w.position, *w.velocity, *w.quaternion, *w.rates, *self.sim._rotors.rpm])
