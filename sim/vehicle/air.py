"""Air flow between vehicles: the rotor jet of each vehicle acts on the others.

Each call updates the jets, which then stay constant until the next call. So a vehicle's motion acts on the
others one tick later. Jets have no transport delay, and wind does not move them.
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
    """Air flow between the vehicles of a team."""

    def __init__(self, team: Sequence[Physics]) -> None:
        self._team = tuple(team)
        # (N, JET) jets of the vehicles at the last call of ``blow``
        self.jets = np.zeros((len(self._team), JET))

    def blow(self) -> None:
        """Apply to each vehicle the current jets of the others, until the next call."""
        if len(self._team) < 2:
            return
        for number, each in enumerate(self._team):
            _blow(each.vehicle, self.jets[number])
        for number, each in enumerate(self._team):
            _feel(each.vehicle, self.jets, number)
