"""Tests one pad for several vehicles: after its landing a vehicle takes off, flies clear and lands."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.strict_toml import ConfigError
from flightstack.core.fleet.member import STAYS_S, FleetMember
from flightstack.core.fleet.precedence import APART, KEPT_M, Pad, Permissions, place_beside
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.target.track import TargetState
from flightstack.core.types import ZERO, Intent, MemberStatus, Phase
from tests.unit.core.fleet.fleet_helpers import settings_of

FLEET = Fleet(3, (3, 7), frees_pad=True)
HERE = TargetState(0.0, ZERO, ZERO, 0.0)
WAITS = {"intent": Intent.WAITING, "claim_s": 0.5, "pad_position_enu_m": (0.02, 0.0, 0.0)}


def word(stamp_s=1.0, position=(1.2, 0.0, 1.0), **told):
    return MemberStatus(7, stamp_s, stamp_s, position, ZERO, ZERO, **told)


def member(fleet=FLEET, **told):
    found = FleetMember(fleet, 0.0)
    assert found.take([word(**told)], 1.0) == []
    return found


@pytest.mark.parametrize(
    ("fleet", "phase", "told", "wanted"),
    [
        (FLEET, Phase.LANDED, WAITS, True),
        (replace(FLEET, frees_pad=False), Phase.LANDED, WAITS, False),
        (FLEET, Phase.LEAVE, WAITS, False),
        (FLEET, Phase.TOUCHDOWN, WAITS, False),
        (FLEET, Phase.LANDED, {**WAITS, "claim_s": math.nan}, False),  # no claim: aborted or landed
        (FLEET, Phase.LANDED, {**WAITS, "pad_position_enu_m": (0.3, 0.0, 0.0)}, False),  # another pad
        (FLEET, Phase.LANDED, {**WAITS, "pad_position_enu_m": None}, False),
        (FLEET, Phase.LANDED, {**WAITS, "stamp_s": 0.4}, False),  # the other vehicle is silent
    ],
)
def test_the_pad_is_wanted_by_who_claims_it_now(fleet, phase, told, wanted):
    way = member(fleet, **told).permissions(phase, HERE, 1.0)
    assert way.pad_wanted is wanted
    if wanted:
        assert way.text == "pad requested by member 7"


def test_that_it_stays_though_others_wait_is_told_once():
    found, wanted = member(**WAITS), Permissions(pad_wanted=True, text="pad requested by member 7")
    assert found.remains_on_pad(wanted, STAYS_S - 0.1, "") == []
    assert found.remains_on_pad(Permissions(), STAYS_S + 0.1, "") == []
    assert found.remains_on_pad(wanted, STAYS_S + 0.1, "4.1 V") == [
        "the vehicle remains on the pad: 4.1 V; pad requested by member 7"
    ]
    assert found.remains_on_pad(wanted, STAYS_S + 9.0, "4.1 V") == []


def claiming(fleet=FLEET, **told):
    """Return a member that claimed the pad at 0.5 s and received a message with these values at 1.0 s."""
    found = FleetMember(fleet, 0.0)
    found.permissions(Phase.APPROACH, HERE, 0.5)
    found.take([word(pad_position_enu_m=ZERO, **told)], 1.0)
    return found


@pytest.mark.parametrize(("away_m", "may_land"), [(0.7, False), (0.9, True)])
def test_who_flies_clear_is_waited_for_until_it_is_away_from_the_pad(away_m, may_land):
    clears = {"intent": Intent.CLEARING, "position": (away_m, 0.0, 1.0)}
    assert claiming(**clears).permissions(Phase.APPROACH, HERE, 1.0).may_land is may_land
    assert claiming(replace(FLEET, frees_pad=False), **clears).permissions(Phase.APPROACH, HERE, 1.0).may_land


coordinate = st.floats(-3.0, 3.0)
speed = st.floats(-0.5, 0.5)


@given(
    pad=st.builds(
        Pad, st.tuples(coordinate, coordinate, st.just(0.2)), st.tuples(speed, speed, st.just(0.0))
    ),
    grounded=st.lists(st.tuples(coordinate, coordinate, st.just(0.0)), max_size=4),
)
def test_the_place_beside_is_off_the_robots_way_and_away_from_who_lies_there(pad, grounded):
    words = [word(position=each, intent=Intent.DOWN) for each in grounded]
    place = place_beside(None, pad.position_enu_m, pad, words, FLEET)
    for part in range(-100, 101):
        t_s = 0.01 * part * FLEET.wait_max_s
        at = [p + t_s * v for p, v in zip(pad.position_enu_m, pad.velocity_enu_m_s, strict=True)]
        assert math.dist(at[:2], place[:2]) >= FLEET.wait_distance_m - 1e-9
    for each in grounded:
        assert math.dist(each[:2], place[:2]) >= APART * FLEET.radius_xy_m - 1e-9
    assert place_beside(place, pad.position_enu_m, pad, words, FLEET) == place


def test_a_place_is_given_up_where_another_pad_comes():
    own, pad = (0.0, 0.0, 1.0), Pad((0.0, 0.0, 0.2), ZERO)
    place = place_beside(None, own, pad, [], FLEET)
    near = (place[0] + FLEET.wait_distance_m - KEPT_M + 0.01, place[1], 0.2)
    assert (
        place_beside(place, own, pad, [word(pad_position_enu_m=near, intent=Intent.WAITING)], FLEET) == place
    )
    nearer = (near[0] - 0.02, *near[1:])
    other = place_beside(place, own, pad, [word(pad_position_enu_m=nearer, intent=Intent.WAITING)], FLEET)
    assert math.dist(other[:2], nearer[:2]) >= FLEET.wait_distance_m


def test_a_place_nearer_than_what_counts_as_clear_is_refused():
    with pytest.raises(ConfigError, match=r"fleet\.wait_distance_m: found 1\.2; .* 1\.3 m"):
        settings_of(3, (3, 7), {"frees_pad": True}, checks={"clearance_m": 1.3})
