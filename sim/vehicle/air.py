"""The air between vehicles: the jets of all are gathered, then each feels those of the others.

Jets are those of the moment of the call and hold until the next one: of what one vehicle does in a tick, the
others feel nothing before the next. They are everywhere at once, and no wind carries them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Cell
from sim.plant.downwash import JET, feel, set_jet
from sim.plant.rotation import rotation_axes
from sim.vehicle.loop import VehicleRecord
from sim.vehicle.physics import Physics


@jitted
def _blow(vehicle: Cell[VehicleRecord], jet: F64) -> None:
    v = vehicle[0]
    body = v.world.body
    set_jet(v.downwash, v.rotors.thrust_n, body.position, rotation_axes(body.quaternion), jet)


@jitted
def _feel(vehicle: Cell[VehicleRecord], jets: F64, own: int) -> None:
    v = vehicle[0]
    body = v.world.body
    feel(v.downwash, jets, own, body.position, rotation_axes(body.quaternion))


class Air:
    """The air of a team. ``team``: its vehicles."""

    def __init__(self, team: Sequence[Physics]) -> None:
        self._team = tuple(team)
        self.jets = np.zeros((len(self._team), JET))  # (N, JET) of the vehicles, at the last call of ``blow``

    def blow(self) -> None:
        """Let each vehicle feel the jets of the others as they are now, until the next call."""
        if len(self._team) < 2:
            return
        for number, each in enumerate(self._team):
            _blow(each.vehicle, self.jets[number])
        for number, each in enumerate(self._team):
            _feel(each.vehicle, self.jets, number)
