"""What is said while a flight waits: each cause by name, and the setting that decides about it."""

from dataclasses import replace

import pytest

from flightstack.core.parameters.ends import Retreat
from flightstack.core.parameters.flight import BarrierShape, Checks, FlightConfig
from flightstack.core.types import Landed, Mode, Phase, VehicleStatus
from flightstack.onboard.waiting import TargetSeen, VehicleSeen, countdown, missing

CHECKS = Checks()
STANDS = VehicleStatus(0.0, False, Mode.HOLD, Landed.ON_GROUND, True)
VEHICLE = VehicleSeen(0.5, "no heartbeat of system 1", 0.01, True, {}, STANDS, True, ())
TARGET = TargetSeen("cf1/target/odom", 0.02, 100, (), ())


def test_nothing_is_missing_when_all_is_there():
    assert missing(VEHICLE, TARGET, CHECKS) == ()


NOT_READY = replace(STANDS, ready_to_arm=False)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"heartbeat_age_s": None, "status": None}, "no heartbeat of system 1"),
        ({"heartbeat_age_s": 3.1}, "no heartbeat of system 1"),
        ({"own_age_s": None}, "no position: the vehicle sends no LOCAL_POSITION_NED"),
        ({"own_age_s": None, "refused": {"without_yaw": 9}}, "without ATTITUDE"),
        ({"own_age_s": 5.0, "refused": {"not_finite": 9}}, "not finite"),
        ({"own_age_s": 5.0, "refused": {"out_of_order": 9}}, "a time that does not advance"),
        ({"own_age_s": 0.31}, "position is 0.3 s old; checks.own_age_max_s allows 0.2"),
        ({"own_believed": False}, "do not agree (checks.own_drift_max_m)"),
        ({"status": replace(STANDS, landed=Landed.UNKNOWN)}, "EXTENDED_SYS_STATE"),
        ({"status": replace(STANDS, landed=Landed.IN_AIR, armed=True)}, "in the air and in mode HOLD"),
        ({"status": NOT_READY, "readiness_told": False}, "whether it may be armed (SYS_STATUS)"),
        (
            {"status": NOT_READY, "says": ("PreArm: Need Position Estimate", "Compass")},
            "pre-arm checks fail (SYS_STATUS); it says: PreArm: Need Position Estimate | Compass",
        ),
    ],
)
def test_each_lack_of_the_vehicle_has_its_sentence(changed, words):
    (text,) = missing(VEHICLE._replace(**changed), TARGET, CHECKS)
    assert words in text


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"age_s": None, "arrived": 0}, "no sample on cf1/target/odom; nor on any key like odometry"),
        ({"age_s": None, "arrived": 0, "keys": ("a/odom", "b/odom")}, "there are a/odom, b/odom"),
        (
            {"age_s": None, "arrived": 0, "problems": ("has the hash RIHS01_0",)},
            "no sample on cf1/target/odom any more; of earlier ones: has the hash RIHS01_0",
        ),
        (
            {"age_s": None, "arrived": 7, "problems": ("frame_id is 'odom'",)},
            "7 samples on cf1/target/odom, none believed: frame_id is 'odom'",
        ),
        ({"age_s": 1.04, "arrived": 0}, "is 1.0 s old; checks.target_age_max_s allows 0.25"),
    ],
)
def test_each_lack_of_the_target_has_its_sentence(changed, words):
    (text,) = missing(VEHICLE, TARGET._replace(**changed), CHECKS)
    assert words in text


def test_without_a_heartbeat_nothing_else_is_said_of_the_vehicle():
    seen = VEHICLE._replace(heartbeat_age_s=None, own_age_s=None, status=None)
    texts = missing(seen, TARGET._replace(age_s=None, arrived=0), CHECKS)
    assert [text.split(" ")[:2] for text in texts] == [["no", "heartbeat"], ["no", "sample"]]


def test_what_ends_a_wait_is_counted_down_with_its_setting():
    config = FlightConfig(
        barrier=BarrierShape(alpha_1_m=1.0, beta_m=1.5), retreat=Retreat(abort_time_max_s=40.0)
    )
    assert countdown(config, Phase.WAIT, 12.0) == "gives up within 48 s (checks.wait_time_max_s)"
    assert countdown(config, Phase.ABORT, 12.0) == "ends within 28 s (retreat.abort_time_max_s)"
    assert countdown(config, Phase.HOLD, 3.0) == "aborts within 0 s (checks.hold_time_s)"
    assert countdown(config, Phase.APPROACH, 3.0) == ""  # left at once
