"""The air between vehicles: the jets of all are gathered, then each feels those of the others.

Jets are those of the moment of the call and hold until the next one: of what one vehicle does in a tick, the
others feel nothing before the next. They are everywhere at once, and no wind carries them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.compiled.jit import jitted
from sim.compiled.records import F64, Cell
from sim.compiled.rotation import rotation_axes
from sim.plant.downwash import JET, feel, induced_m_s, size_m
from sim.vehicle.loop import VehicleRecord
from sim.vehicle.physics import Physics


@jitted
def _feel(vehicle: Cell[VehicleRecord], jets: F64, own: int) -> None:
    v = vehicle[0]
    body = v.world.body
    feel(v.downwash, jets, own, body.position, rotation_axes(body.quaternion))


def jet_of(physics: Physics) -> list[float]:
    """The jet of a vehicle now, ``JET`` numbers; its velocity is zero when the rotors stand.

    Args:
        physics: the vehicle.
    """
    body, rotor = physics.body(), physics.params.rotor
    x, y, z = body[:3]
    zx, zy, zz = rotation_axes(body[6:10])[6:]
    up, speed = rotor.above_com_m, induced_m_s(float(physics.record.rotors.thrust_n), rotor)
    return [x + up * zx, y + up * zy, z + up * zz, -zx, -zy, -zz, speed, size_m(rotor)]


class Air:
    """The air of a team.

    Args:
        team: its vehicles.
    """

    def __init__(self, team: Sequence[Physics]) -> None:
        self._team = tuple(team)
        self._jets = np.zeros((len(self._team), JET))

    def blow(self) -> None:
        """Let each vehicle feel the jets of the others as they are now, until the next call."""
        if len(self._team) < 2:
            return
        for number, each in enumerate(self._team):
            self._jets[number] = jet_of(each)
        for number, each in enumerate(self._team):
            _feel(each.vehicle, self._jets, number)
