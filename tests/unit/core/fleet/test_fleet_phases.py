"""The rows of neighbours hold in each phase that commands a velocity, but for the touchdown."""

import math

import pytest

from flightstack.core.controller import Controller
from flightstack.core.memory import AbortWay
from flightstack.core.types import (
    ZERO,
    Inputs,
    Intent,
    Landed,
    Mode,
    Neighbour,
    OwnState,
    Phase,
    TargetSample,
    VehicleStatus,
)
from tests.unit.core.fleet.fleet_helpers import DT_S, settings_of

# 9 is never heard: it begins nothing, and gets no right of way
SETTINGS = settings_of(3, (3, 7, 9), takeoff={"start_offset_m": [2.0, 0.0, 1.0]})
EAST, UP, DOWN = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
CLEAR = {"abort_way": AbortWay.FLY_CLEAR}
PHASES = [
    (Phase.WAIT, {}, (2.0, 0.0, 1.5), None),  # stands still
    (Phase.TAKEOFF, {"climbed": True}, (0.0, 0.0, 1.2), EAST),
    (Phase.APPROACH, {}, (-2.0, 0.0, 1.2), EAST),
    (Phase.HOLD, {"started_s": 0.0}, (0.5, 0.0, 1.0), UP),
    (Phase.CLIMB, {"started_s": 0.0}, (0.5, 0.0, 0.5), UP),
    (Phase.ABORT, CLEAR, (0.3, 0.0, 2.5), EAST),
    (Phase.LEAVE, {}, (0.0, 0.0, 0.3), UP),
    (Phase.TOUCHDOWN, {}, (0.0, 0.0, 0.35), DOWN),
]


def flown(phase, keys, place, words):
    """Velocity wanted in a tick of this phase."""
    controller = Controller(SETTINGS)
    memory = controller.memory
    memory.phase, memory.was_armed, memory.was_external = phase, True, True
    memory.target_position_enu_m, memory.target_velocity_enu_m_s = (0.0, 0.0, 0.2), ZERO
    memory.commanding, memory.command = True, ZERO
    for name, value in keys.items():
        setattr(memory, name, value)
    now_s = 2 * DT_S
    own = OwnState(now_s, now_s, place, ZERO, 0.0)
    status = VehicleStatus(now_s, True, Mode.EXTERNAL, Landed.IN_AIR, False)
    sample = TargetSample(now_s, now_s, "map", "target", (0.0, 0.0, 0.2), ZERO, 0.0, 0.0)
    out = controller.step(Inputs(own, status, (sample,), neighbours=tuple(words)), now_s)
    assert out.phase is phase
    return out.wanted


def beside(place, way, h_m):
    """A vehicle that stands in the air in this direction, so near that h is this."""
    far_m = (0.75 if way[2] else 0.25) + (3.0 if way[2] else 1.0) * h_m
    at = tuple(p + far_m * w for p, w in zip(place, way, strict=True))
    return Neighbour(7, 2 * DT_S, 2 * DT_S, at, ZERO, ZERO, intent=Intent.WAITING)


@pytest.mark.parametrize(("phase", "keys", "place", "way"), PHASES, ids=[p[0].name for p in PHASES])
def test_a_neighbour_in_the_way_stops_each_phase_but_the_touchdown(phase, keys, place, way):
    if way is None:
        assert flown(phase, keys, place, []) == pytest.approx(ZERO, abs=1e-9)
        pushed = flown(phase, keys, place, [beside(place, EAST, -0.1)])
        assert pushed[0] < -0.02
        return
    alone = flown(phase, keys, place, [])
    ahead_m_s = sum(a * w for a, w in zip(alone, way, strict=True))
    assert ahead_m_s > 0.025
    there = flown(phase, keys, place, [beside(place, way, 0.015)])
    if phase is Phase.TOUCHDOWN:
        assert there == alone
        return
    # half of the rate, of what is left besides the errors of two places
    assert sum(a * w for a, w in zip(there, way, strict=True)) <= 0.02
    assert flown(phase, keys, place, [beside(place, way, 2.9)]) == alone  # out of reach
    assert math.dist(flown(phase, keys, place, [beside(place, way, 1.5)]), alone) < 1e-6  # in reach
