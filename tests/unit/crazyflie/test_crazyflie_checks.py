"""Every refusal of arming, with its reason, over the real decoder."""

import pytest

from tests.crazyflie_firmware.bench import Bench
from tests.crazyflie_firmware.firmware import Firmware


def set_param(name, value):
    def change(bench):
        bench.firmware.params[name].value = value

    return change


def set_attribute(path, value):
    def change(bench):
        *way, last = path.split(".")
        owner = bench.firmware
        for step in way:
            owner = getattr(owner, step)
        setattr(owner, last, value)

    return change


def silent(bench):
    bench.run(0.5)
    bench.mute = True
    bench.run(0.4)


REFUSALS = {
    "old protocol": (set_attribute("protocol", 9), "firmware speaks CRTP 9, arming by supervisor needs 12"),
    "tumbled": (set_attribute("supervisor.tumbled", True), "lies on its side"),
    "checks": (set_attribute("supervisor.checks_pass", False), "pre-flight checks have not passed"),
    "charging": (set_attribute("power_state", 1), "it is charging"),
    "low power": (set_attribute("power_state", 3), "battery at 4.10 V"),
    "low battery": (set_attribute("battery_v", 3.5), "battery at 3.50 V, 3.7 V needed"),
    "mellinger": (set_param("stabilizer.controller", 2), "controller is 2, which flies no velocities"),
    "no position": (set_attribute("needs_poses", True), "Lighthouse deck: are the base stations seen"),
    "silent": (silent, "s old: radio too weak?"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refuses_to_arm_and_says_why(name):
    change, reason = REFUSALS[name]
    firmware = Firmware(auto_arm=False)
    bench = Bench(firmware)
    change(bench)
    if not bench.mute:
        bench = Bench(firmware).run(1.0)
    assert bench.result(400, 1.0) == 1
    bench.step()
    said = [text for text in bench.texts if text.startswith("Arming refused: ")]
    assert len(said) == 1
    assert reason in said[0]
    assert not bench.vehicle.armed
    assert not bench.firmware.supervisor.armed
    assert not bench.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000


def test_without_any_deck_it_asks_for_motion_capture():
    firmware = Firmware(needs_poses=True)
    firmware.params["deck.bcLighthouse4"].value = 0
    bench = Bench(firmware).run(1.0)
    assert any("give poses with --mocap" in problem for problem in bench.vehicle.problems(bench.now_s))


def test_a_filter_that_does_not_run_is_no_position_estimate():
    firmware = Firmware()
    bench = Bench(firmware).run(0.5)
    assert not bench.vehicle.problems(bench.now_s)  # the bridge has set the estimator
    assert firmware.params["stabilizer.estimator"].value == 2
    firmware.params["stabilizer.estimator"].value = 1
    bench.run(0.5)
    assert "no position estimate" in bench.vehicle.problems(bench.now_s)[0]


def test_prearm_checks_tell_all_reasons_in_order():
    firmware = Firmware(protocol=9, needs_poses=True)
    firmware.battery_v = 3.3
    bench = Bench(firmware).run(1.0)
    assert bench.result(401) == 0
    bench.step()
    said = [text for text in bench.texts if text.startswith("Preflight fail")]
    assert ["CRTP" in said[0], "battery" in said[1], "no position" in said[2]] == [True] * 3


def test_what_keeps_it_from_arming_is_said_when_it_changes_and_not_again():
    firmware = Firmware(auto_arm=False)
    bench = Bench(firmware).run(3.0)
    for volts in (3.6, 3.5, 3.4):
        firmware.battery_v = volts
        bench.run(2.0)
    firmware.battery_v = 4.0
    bench.run(2.0)
    said = [t for t in bench.texts if t == "Ready to arm" or t.startswith("Not ready")]
    assert said == ["Ready to arm", "Not ready: battery at 3.60 V, 3.7 V needed: charge it", "Ready to arm"]
