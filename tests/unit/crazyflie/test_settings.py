"""Tests that the bridge writes firmware parameters at each connection, and restores them on request."""

from __future__ import annotations

import pytest

from bridge.crazyflie.packets import SetParam
from bridge.crazyflie.rules import DRAG, ECHO_MAX_S, UNKNOWN_DRAG, Rules
from flightstack.cli.real import _drag_1_s
from flightstack.common.strict_toml import ConfigError
from tests.crazyflie_firmware.bench import Bench
from tests.crazyflie_firmware.firmware import Firmware

RULES = Rules(drag_1_s=(0.46, 0.46, 0.4), restore=True)
FOUND = {"stabilizer.estimator": 1.0, **dict.fromkeys(DRAG, 0.0)}


def test_the_drag_is_written_again_where_a_restart_has_lost_it():
    bench = Bench(rules=RULES).run(0.1)
    params = bench.firmware.params
    assert [params[name].value for name in DRAG] == [0.46, 0.46, 0.4]
    assert "kalman.dragB_z is 0.4" in bench.texts
    params[DRAG[0]].value = 0.0
    bench.lose()
    bench.connect()
    assert params[DRAG[0]].value == 0.46
    written = [packet.name for _, packet in bench.sent if isinstance(packet, SetParam)]
    assert [written.count(name) for name in DRAG] == [2, 1, 1]


def test_what_it_found_is_restored_once_and_waited_for_within_a_bound():
    bench = Bench(rules=RULES).run(0.1)
    settings, now_s = bench.vehicle.settings, bench.now_s
    assert dict(settings.leave(now_s)) == FOUND
    assert settings.leave(now_s) == []
    assert settings.busy(now_s + 0.9 * ECHO_MAX_S)
    assert not settings.busy(now_s + 1.1 * ECHO_MAX_S)
    for name in FOUND:
        assert settings.busy(now_s)
        settings.echoed(name)
    assert not settings.busy(now_s)


def test_a_firmware_that_cannot_be_told_its_drag_is_named():
    firmware = Firmware()
    for name in DRAG:
        del firmware.params[name]
    assert UNKNOWN_DRAG in Bench(firmware, RULES).run(0.1).texts
    assert UNKNOWN_DRAG not in Bench(firmware).run(0.1).texts


def test_the_drag_is_that_of_the_vehicle_file():
    assert _drag_1_s("crazyflie20") == pytest.approx((0.461, 0.461, 0.401), abs=0.001)
    assert _drag_1_s("none") is None
    with pytest.raises(ConfigError, match="crazyflie20"):
        _drag_1_s("crazyflie99")
