"""Tests the thrust reserve from voltage and from throttle, and which flights a low battery allows."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.reserve import GRAVITY_M_S2, LEAST_M_S2, Reserve, left, level_m_s2, up_m_s2
from flightstack.core.target.reserve import AGE_MAX_S, ReserveEstimate, too_low
from flightstack.core.types import Charge, Landed, Mode, Phase, Power, VehicleStatus
from tests.point_mass import World
from tests.unit.core.core_helpers import config

MOST_M_S2 = (2.0, 2.0, 2.5)
TABLE = {"hover_throttle": 0.78, "hover_voltage_v": 3.7, "lowest_voltage_v": 3.2, "sag_v": 0.4}
RESERVE = Reserve(**TABLE)
LEAST = RESERVE.at(3.2)
STANDS = VehicleStatus(0.0, False, Mode.HOLD, Landed.ON_GROUND, True)
FLIES = VehicleStatus(0.0, True, Mode.EXTERNAL, Landed.IN_AIR, True)
STEP_S = 0.01


def estimate(table=RESERVE):
    return ReserveEstimate(table, MOST_M_S2, STEP_S)


def power(now_s=0.0, volts=3.7, throttle=0.78, tilt_rad=0.0):
    return Power(now_s, volts, throttle, math.cos(tilt_rad))


def fly(found, seconds, throttle, volts=3.7, rise_m_s=lambda _t: 0.0, tilt_rad=0.0):
    for n in range(round(seconds / STEP_S)):
        t = n * STEP_S
        said = power(t, volts, throttle(t) if callable(throttle) else throttle, tilt_rad)
        found.step(said, FLIES, rise_m_s(t), t, flies=True)
    return found


tables = st.builds(
    Reserve,
    hover_throttle=st.floats(0.3, 0.8),
    hover_voltage_v=st.floats(3.5, 4.0),
    lowest_voltage_v=st.just(3.4),
    sag_v=st.floats(0.0, 0.5),
    thrust_exponent=st.floats(1.0, 2.2),
)


@given(tables, st.floats(3.4, 4.2))
def test_voltage_and_reserve_are_each_others_inverse_and_rise_together(table, volts):
    assert table.voltage_v(table.at(volts)) == pytest.approx(volts, abs=1e-6)
    assert table.at(volts + 0.01) > table.at(volts)


def test_a_firmware_that_compensates_the_battery_ends_at_its_own_limit():
    """A voltage below the compensated voltage reduces the maximum thrust; a higher voltage has no effect."""
    table = replace(RESERVE, motor_voltage_max_v=3.07)
    assert table.at(4.0) == table.at(3.7) == pytest.approx((3.07 / (0.78 * 3.7)) ** 1.5)
    assert table.at(3.2) == RESERVE.at(3.2) < table.at(3.7) < RESERVE.at(3.7)
    assert table.voltage_v(table.at(3.7) + 0.01) == math.inf
    assert table.voltage_v(table.at(3.15)) == pytest.approx(3.15)
    with pytest.raises(ConfigError, match="a higher motor_voltage_max_v"):
        replace(RESERVE, motor_voltage_max_v=2.8)


def test_a_lowest_voltage_that_lifts_nothing_is_refused_with_the_one_that_does():
    with pytest.raises(ConfigError, match=r"found 2\.9.*allowed is more than 3\.04") as told:
        Reserve(**TABLE | {"lowest_voltage_v": 2.9})
    assert "hover_throttle" in str(told.value)
    with pytest.raises(ConfigError, match=r"reserve: found 2\.9|reserve.*lowest_voltage_v"):
        config(reserve=TABLE | {"lowest_voltage_v": 2.9})
    with pytest.raises(ConfigError, match=r"reserve\.hover_throttle: missing"):
        config(reserve={"hover_voltage_v": 3.7, "lowest_voltage_v": 3.2})


@given(st.floats(1.0, 1.6), st.floats(0.1, 1.0))
def test_all_accelerations_together_are_no_more_than_the_thrust(reserve, share):
    table = replace(RESERVE, share=share)
    up, level = up_m_s2(reserve, table.share), level_m_s2(reserve, table.share)
    if min(up, level) > LEAST_M_S2:
        assert math.hypot(level, level, GRAVITY_M_S2 + up) <= reserve * GRAVITY_M_S2 + 1e-9


@given(st.floats(0.6, 0.93), st.floats(0.0, 0.3), st.floats(0.2, 2.0), st.floats(0.0, 0.5))
def test_neither_climbs_nor_tilt_disturb_the_estimate(hover, sway_m_s, rate_1_s, tilt_rad):
    """The estimated reserve is right within 0.2 %, although climbs and tilt change the throttle."""

    def rise(t):
        return sway_m_s * math.sin(rate_1_s * t)

    def throttle(t):
        gained = (rise(t) - rise(t - STEP_S)) / STEP_S / GRAVITY_M_S2
        return hover * ((1.0 + gained) / math.cos(tilt_rad)) ** (1.0 / RESERVE.thrust_exponent)

    found = fly(estimate(), 20.0, throttle, rise_m_s=rise, tilt_rad=tilt_rad)
    expected = left(RESERVE.effort(hover), RESERVE.sags(3.7), RESERVE.most(3.7))
    assert found.reserve == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("said", [None, power(0.0, math.nan, math.nan)])
def test_without_data_the_least_reserve_counts_and_nothing_is_begun(said):
    found = estimate()
    found.step(said, STANDS, 0.0, 0.1, flies=False)
    assert found.charge is Charge.UNKNOWN
    assert "no battery voltage received" in found.text
    assert math.isnan(found.reserve)
    assert found.acceleration_max_m_s2[2] == pytest.approx(up_m_s2(LEAST, RESERVE.share))


def test_data_that_stop_in_flight_are_no_reserve_and_no_reason_to_abort():
    found = fly(estimate(), 5.0, 0.78)
    assert found.charge is Charge.FIT
    assert found.text == ""
    found.step(power(5.0), FLIES, 0.0, 5.0 + AGE_MAX_S + 0.1, flies=True)
    assert found.charge is Charge.UNKNOWN
    assert found.acceleration_max_m_s2[2] == pytest.approx(up_m_s2(LEAST, RESERVE.share))


def test_in_flight_a_tired_battery_stays_tired_until_the_vehicle_stands_disarmed():
    found = fly(estimate(), 5.0, 0.95, volts=3.2)
    assert found.charge is Charge.TIRED
    for number in ("1.0", "3.20 V", f"{LEAST:.2f}", "change the battery"):
        assert number in found.text
    fly(found, 20.0, 0.7)
    assert found.reserve > LEAST
    assert found.charge is Charge.TIRED
    found.step(power(20.0, 4.1), STANDS, 0.0, 20.0, flies=False)
    assert found.charge is Charge.FIT


def test_at_rest_the_sag_to_come_and_the_flight_itself_are_counted_in():
    least_v = 3.2 + 0.05 + 0.4
    assert too_low(RESERVE, least_v) == ""
    text = too_low(RESERVE, least_v - 0.01)
    assert "3.64 V" in text
    assert "3.65 V" in text
    assert "charge or change it" in text
    found = estimate()
    found.step(power(volts=least_v - 0.01), STANDS, 0.0, 0.0, flies=False)
    assert found.charge is Charge.TIRED
    assert found.text == text


CONFIG = config(reserve=TABLE, checks={"wait_time_max_s": 2.0})


def told(volts, throttle, from_s=0.0):
    """Return arguments of ``World``: a fault that adds battery reports to the inputs from ``from_s`` on."""

    def fault(world, inputs):
        said = Power(world.t_s, volts, throttle, 1.0) if world.t_s >= from_s else None
        return inputs._replace(power=said)

    return {"fault": fault, "fault_from_s": 0.0, "fault_to_s": math.inf}


def test_a_tired_battery_keeps_a_vehicle_on_the_ground_and_the_reason_says_why():
    ground = {"position": (-1.5, 0.2, 0.0), "armed": False, "landed": Landed.ON_GROUND}
    world = World(CONFIG, **ground, **told(3.5, 0.0))
    while world.t_s < 3.0:
        world.step()
    assert world.phase is Phase.ABORT
    assert not world.sent
    assert "the battery has 3.50 V at rest" in world.texts[-1]
    silent = World(CONFIG, **ground, **told(4.1, 0.0, from_s=99.0))
    while silent.t_s < 3.0:
        silent.step()
    assert silent.phase is Phase.ABORT
    assert "no battery voltage received" in silent.texts[-1]
