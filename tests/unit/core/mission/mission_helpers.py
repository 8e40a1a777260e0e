"""Computes the condition flags of the mission logic in one tick, for given inputs."""

from flightstack.core.fleet.precedence import ALONE
from flightstack.core.memory import Memory
from flightstack.core.mission.machine import Mission
from flightstack.core.mission.phases import Condition
from flightstack.core.snapshot import snapshot_of
from flightstack.core.strategies.strategy import strategy_of
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.reserve import ReserveEstimate
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import Charge, Inputs, Landed, Mode, Operator, OwnState, VehicleStatus
from tests.unit.core.core_helpers import config

NOW_S = 100.0
STILL = (0.0, 0.0, 0.0)
PAD = (3.0, -2.0, 0.2)


def starting(filter="robust", **sections):
    """Return a configuration that gives the start point of the landing."""
    return config(filter, takeoff={"start_offset_m": [-1.4, 0.5, 0.72]}, **sections)


ROBUST, PAPER = starting(), starting("paper")
BARRIER = ROBUST.barrier


def mission_of(settings, strategy=None, track=None, plausibility=None):
    """Return the mission of a vehicle without a battery table."""
    return Mission(
        settings, strategy or strategy_of(settings), track or TargetTrack(settings.checks),
        plausibility or Plausibility(settings), ReserveEstimate(None, STILL, 0.01),
    )  # fmt: skip


def tick(
    settings=ROBUST, e=(1.0, 0.0, 1.0), velocity=STILL, target_velocity=STILL, *, now_s=NOW_S, memory=None,
    sigma_m=0.0, own_age_s=0.01, target_age_s=0.03, status_age_s=0.2, armed=True, mode=Mode.EXTERNAL,
    landed=Landed.IN_AIR, ready=True, operator=Operator.NONE, failed=False, follows=True, trusted=True,
    without=(), permissions=ALONE, charge=Charge.FIT,
):  # fmt: skip
    """Return the condition flags of one tick; each argument replaces a value of inputs without faults."""
    position = tuple(a + b for a, b in zip(e, PAD, strict=True))
    own = OwnState(now_s - own_age_s, 0.0, position, velocity, 0.0)
    status = VehicleStatus(now_s - status_age_s, armed, mode, landed, ready)
    target = TargetState(target_age_s, PAD, target_velocity, 0.0, sigma_m)
    inputs = Inputs(
        None if "own" in without else own, None if "status" in without else status, (), operator
    )  # fmt: skip
    known = None if "target" in without else target
    seen = snapshot_of(
        settings, inputs, known, now_s, trusted=trusted, follows=follows, charge=charge,
        permissions=permissions,
    )  # fmt: skip
    strategy = strategy_of(settings)
    mission = mission_of(settings, strategy)
    mission.memory = memory if memory is not None else Memory()
    return mission.flags(seen, command_failed=failed, now_s=now_s)


def names(word):
    return {c.name for c in Condition if word & c}
