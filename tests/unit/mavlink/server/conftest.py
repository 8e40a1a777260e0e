"""Runs every test of the MAVLink server with both vehicles that use it."""

from __future__ import annotations

import copy
import functools

import pytest

from tests.unit.autopilot.autopilot_fakes import Rig
from tests.unit.mavlink.server.served import TICK_S, Bridged, Served


class Simulated(Rig):
    """The simulated autopilot."""

    def __init__(self) -> None:
        super().__init__()
        self.run(TICK_S)

    offboard = Served.offboard


USERS: dict[str, type[Served]] = {"px4": Simulated, "crazyflie": Bridged}


@functools.cache
def prepared(user: str, situation: str) -> Served:
    """Return a vehicle in this situation from a cache; copy the vehicle before use."""
    made = USERS[user]()
    if situation != "disarmed":
        getattr(made, situation)()
    made.texts()
    made.forget()
    return made


VIEWS = ("due_s", "voltage_v", "throttle")  # fields of the watches' record that have a view


def copied(made: Served) -> Served:
    """Return a copy of a vehicle; its views refer to the copied record of the autopilot's watches."""
    memo, watches = {}, getattr(getattr(made.server, "flight", None), "watches", None)
    if watches is not None:
        memo[id(watches.cell)] = record = watches.cell.copy()
        memo |= {id(getattr(watches, f"_{name}")): record[name].data for name in VIEWS}
    return copy.deepcopy(made, memo)


@pytest.fixture(params=USERS)
def user(request) -> str:
    return request.param


@pytest.fixture
def fresh(user):
    """Return a function that makes a vehicle: ``disarmed``, ``homed``, ``fly`` or ``offboard``."""

    def make(situation: str) -> Served:
        return copied(prepared(user, situation))

    return make


@pytest.fixture
def numbers(user) -> frozenset[int]:
    """Return the numbers (MAV_CMD) of the commands that the vehicle supports."""
    return frozenset(prepared(user, "disarmed").server.commands.table)


@pytest.fixture
def served(fresh) -> Served:
    return fresh("disarmed")


@pytest.fixture
def flown(fresh) -> Served:
    return fresh("offboard")
