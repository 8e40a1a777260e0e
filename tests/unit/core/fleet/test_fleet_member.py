"""Tests when a fleet member sends messages, and which configurations are refused."""

import pytest

from flightstack.common.strict_toml import ConfigError
from flightstack.core.controller import Controller
from flightstack.core.types import Inputs, Intent, Landed, Mode, OwnState, VehicleStatus
from tests.unit.core.core_helpers import config
from tests.unit.core.fleet.fleet_helpers import fleet, settings_of


def test_a_vehicle_that_does_not_know_where_it_is_says_nothing():
    controller = Controller(settings_of(3, (3, 7)))
    status = VehicleStatus(0.0, True, Mode.EXTERNAL, Landed.IN_AIR, True)
    assert controller.step(Inputs(None, status), 0.0).member_status is None
    own = OwnState(0.0, 0.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0)
    assert controller.step(Inputs(own, status), 0.0).member_status.intent is Intent.WAITING
    assert controller.step(Inputs(own, status), 1.0).member_status is None


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"members": [3]}, "members: found 1"),
        ({"members": [7, 9]}, "id 3"),
        ({"members": [3, 7, 7]}, "each once"),
        ({"members": list(range(1, 11))}, "members: found 10, allowed are 2 to 9"),
        ({"id": 251}, "1 to 250"),
        ({"reach_m": 2.7}, "reach_m: found 2.7"),
        ({"age_max_s": 0.4}, "age_max_s: found 0.4"),
        ({"pad_distance_m": 0.45}, "pad_distance_m: found 0.45"),
        ({"wait_distance_m": 0.7}, "wait_distance_m: found 0.7"),
        ({"rate_1_s": 1.0}, "fleet.rate_1_s: found 1"),
        ({"latency_max_s": 0.015}, "fleet.latency_max_s: found 0.015"),
    ],
)
def test_a_fleet_that_cannot_work_is_refused(keys, why):
    table = {**fleet(), **keys}
    with pytest.raises(ConfigError, match=why):
        config(fleet=table, loop={"rate_hz": 50})
