"""Tests which poses of the motion capture are forwarded, and which messages the vehicle receives."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav
from scipy.spatial.transform import Rotation

from bridge.mavlink.client.companion import Origin
from bridge.mocap.checks import Limits, Passed, PoseChecks, Refusal, angle_between
from bridge.mocap.process import (
    RATE_MAX_HZ,
    MocapSource,
    MocapVehicle,
    odometry,
    vision_position_estimate,
)
from bridge.ros2.cdr import Pose
from bridge.target.ros2_target import TargetSpec, TargetType
from bridge.zenoh import zenoh_link
from tests.processes.bounded import wait_for
from tests.processes.ports import free_endpoint
from tests.unit.mavlink.codec.frames_of_messages import packed
from tests.unit.target.ros2_helpers import pose_stamped

SPEC = TargetSpec.parse("lab/pose", TargetType.POSE)
LEVEL = (1.0, 0.0, 0.0, 0.0)
S = 1_000_000_000
EPOCH_S = 1.7e9  # offset of the motion capture computer's clock, s
UNIT = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: sum(e * e for e in q) > 0.01)
    .map(lambda q: tuple(e / math.sqrt(sum(x * x for x in q)) for e in q))
)
POINT = st.tuples(*[st.floats(-20.0, 20.0)] * 3)
ENU_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_TO_FRD = np.diag([1.0, -1.0, -1.0])


def sample(at_s, position=(0.0, 0.0, 0.0), q=LEVEL, *, frame="map"):
    return Pose(round((EPOCH_S + at_s) * S), frame, position, q)


def stream(checks, start_s, seconds, position=(0.0, 0.0, 0.0), rate_hz=100.0, *, armed=False, **more):
    """Feed poses at a constant rate; return the forwarded poses and the last problem."""
    passed, problem = [], None
    for i in range(round(seconds * rate_hz)):
        at_s = start_s + i / rate_hz
        passed += checks.step([sample(at_s, position, **more)], at_s + 0.003, armed=armed)
        problem = checks.problem(at_s + 0.004)
    return passed, problem


def test_a_steady_stream_is_passed_on_with_the_time_it_was_measured():
    checks = PoseChecks()
    passed, problem = stream(checks, 0.0, 3.0)
    assert problem is None
    assert len(passed) == 300
    assert all(abs(p.measured_s - (i / 100.0 + 0.003)) < 1e-3 for i, p in enumerate(passed))
    assert sum(checks.counts.values()) == 0


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (lambda at_s: None, Refusal.UNREADABLE),
        (lambda at_s: sample(at_s, frame="world"), Refusal.FRAME),
        (lambda at_s: sample(at_s - 0.5), Refusal.ORDER),
        (sample, Refusal.LATE),
        (lambda at_s: sample(at_s, (0.0, 0.0, 101.0)), Refusal.ROOM),
        (lambda at_s: sample(at_s, (0.3, 0.0, 0.0)), Refusal.JUMP),
        (lambda at_s: sample(at_s, q=(0.0, 0.0, 0.0, 1.0)), Refusal.JUMP),
    ],
)
def test_bad_poses_are_refused_counted_and_explained(bad, reason):
    checks = PoseChecks(Limits(frame_id="map"))
    stream(checks, 0.0, 2.0)
    assert checks.step([bad(2.0)], 2.2 if reason is Refusal.LATE else 2.003, armed=False) == ()
    assert checks.counts[reason] == 1
    assert sum(checks.counts.values()) == 1
    problem = checks.problem(2.5)
    assert problem.startswith("mocap: no pose for 0.5 s; the last was ")
    assert reason.value in problem
    passed, problem = stream(checks, 2.6, 1.0)
    assert len(passed) > 80
    assert problem is None


def test_a_slow_stream_is_a_problem_and_a_fast_one_is_thinned():
    checks = PoseChecks()
    _, problem = stream(checks, 0.0, 4.0, rate_hz=10.0)
    assert problem == "mocap: 10 Hz, 20 Hz needed"
    fast = PoseChecks(Limits(rate_max_hz=50.0))
    passed, problem = stream(fast, 0.0, 4.0, rate_hz=300.0)
    assert problem is None
    assert 190 <= len(passed) <= 305
    assert fast.thinned + len(passed) == 1200


def test_armed_a_jump_is_never_believed_disarmed_after_a_second():
    checks = PoseChecks()
    stream(checks, 0.0, 1.0, armed=True)
    passed, problem = stream(checks, 1.0, 5.0, (1.0, 0.0, 0.0), armed=True)
    assert passed == []
    assert "a jump no vehicle can make" in problem
    passed, problem = stream(checks, 6.0, 3.0, (1.0, 0.0, 0.0))
    assert problem is None
    assert {p.resets for p in passed} == {1}
    assert passed[0].measured_s == pytest.approx(7.0, abs=0.05)


def passed_at(checks, since_s, seconds, ahead_s=0.0):
    """Feed poses at 100 Hz with this offset of the stamps; return the times of the forwarded poses, s."""
    times = [since_s + 0.01 * k for k in range(round(seconds * 100))]
    return [t for t in times if checks.step([sample(t + ahead_s)], t, armed=True)]


@pytest.mark.parametrize("by_s", [-1.7e9, -2.0, -0.2, 0.04, 0.2, 3600.0])
def test_a_clock_that_was_set_is_followed_after_poses_that_agree(by_s):
    checks = PoseChecks()
    passed_at(checks, 0.0, 2.0)
    passed = passed_at(checks, 2.0, 2.0, by_s)
    assert passed[0] == pytest.approx(2.3, abs=0.011)
    assert len(passed) >= 169


def test_two_bodies_that_take_turns_are_never_believed():
    checks = PoseChecks()
    stream(checks, 0.0, 1.0)
    for i in range(500):
        at_s = 1.0 + i / 100.0
        place = ((1.0, 0.0, 0.0), (3.0, 0.0, 0.0))[i % 2]
        assert checks.step([sample(at_s, place)], at_s + 0.004, armed=False) == ()


def test_what_was_lost_for_a_while_may_be_somewhere_else():
    checks = PoseChecks()
    stream(checks, 0.0, 1.0, armed=True)
    passed = checks.step([sample(2.0, (3.0, 0.0, 0.0))], 2.004, armed=True)
    assert len(passed) == 1  # a vehicle can fly 3 m in 1 s
    assert checks.step([sample(9.0, (9.0, 0.0, 0.0))], 9.004, armed=True) == ()


@given(st.lists(st.tuples(st.floats(0.0, 5.0), POINT, st.booleans()), max_size=60))
def test_no_two_poses_in_a_row_are_further_apart_than_a_vehicle_flies(course):
    checks = PoseChecks()
    at_s, last = 0.0, None
    for gap_s, place, armed in course:
        at_s += gap_s
        for passed in checks.step([sample(at_s, place)], at_s + 0.004, armed=armed):
            if last is not None and passed.resets == last.resets:
                dt_s = (passed.pose.stamp_ns - last.pose.stamp_ns) / S
                assert (
                    math.dist(passed.pose.position_m, last.pose.position_m)
                    <= 0.05 + 5.0 * min(dt_s, 1.0) + 1e-6
                )
            last = passed


@given(UNIT, UNIT)
def test_the_angle_between_attitudes_is_that_of_another_implementation(a, b):
    expected = (Rotation.from_quat([*a[1:], a[0]]).inv() * Rotation.from_quat([*b[1:], b[0]])).magnitude()
    assert angle_between(a, b) == pytest.approx(expected, abs=1e-6)
    assert angle_between(a, tuple(-e for e in b)) == pytest.approx(angle_between(a, b), abs=1e-9)


@given(POINT, UNIT, POINT)
def test_the_offset_of_the_markers_turns_with_the_body(position, q, offset):
    moved = Pose(0, "map", position, q).shifted(offset)
    turned = Rotation.from_quat([*q[1:], q[0]]).apply(offset)
    assert moved.position_m == pytest.approx(np.add(position, turned), abs=1e-9)
    assert moved.orientation_wxyz == q


def wire(message):
    return mav.MAVLink(None).decode(bytearray(packed(message, 0, 1, 197)))


def covariance(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    return tuple(float(e) for e in (root @ root.T).ravel())


@given(POINT, UNIT, st.integers(0, 2**32))
def test_both_messages_carry_the_pose_into_the_ned_room(position, q, seed):
    passed = Passed(Pose(0, "map", position, q, covariance(seed)), 1.5, 3)
    turned = ENU_TO_NED @ Rotation.from_quat([*q[1:], q[0]]).as_matrix() @ FLU_TO_FRD
    blocks = np.kron(np.eye(2), ENU_TO_NED)
    expected = (blocks @ np.reshape(passed.pose.covariance, (6, 6)) @ blocks.T)[np.triu_indices(6)]

    odom = wire(odometry(passed, 1_500_000))
    assert (odom.x, odom.y, odom.z) == pytest.approx(ENU_TO_NED @ position, rel=1e-5, abs=1e-5)
    w, x, y, z = odom.q
    assert Rotation.from_quat([x, y, z, w]).as_matrix() == pytest.approx(turned, abs=1e-5)
    assert odom.pose_covariance == pytest.approx(expected, rel=1e-4, abs=1e-5)
    assert (odom.frame_id, odom.child_frame_id, odom.estimator_type) == (1, 12, mav.MAV_ESTIMATOR_TYPE_VISION)
    assert (odom.time_usec, odom.reset_counter) == (1_500_000, 3)
    assert all(math.isnan(v) for v in (odom.vx, odom.vy, odom.vz, odom.velocity_covariance[0]))

    vision = wire(vision_position_estimate(passed, 1_500_000))
    assert (vision.x, vision.y, vision.z) == pytest.approx(ENU_TO_NED @ position, rel=1e-5, abs=1e-5)
    back = Rotation.from_euler("ZYX", [vision.yaw, vision.pitch, vision.roll]).as_matrix()
    assert back == pytest.approx(turned, abs=2e-3)  # single precision is worst at a pitch of 90 degrees
    assert vision.covariance == pytest.approx(expected, rel=1e-4, abs=1e-5)
    assert (vision.usec, vision.reset_counter) == (1_500_000, 3)


def test_a_covariance_that_is_not_known_says_so():
    passed = Passed(Pose(0, "map", (1.0, 2.0, 3.0), LEVEL), 0.0, 300)
    assert math.isnan(wire(odometry(passed, 1)).pose_covariance[0])
    vision = wire(vision_position_estimate(passed, 1))
    assert math.isnan(vision.covariance[0])
    assert vision.reset_counter == 44


def heartbeat(autopilot, *, armed=False):
    return mav.MAVLink_heartbeat_message(2, autopilot, 128 if armed else 0, 0, 3, 3)


def kinds(messages):
    return [m.get_type() for m in messages]


@pytest.mark.parametrize(("autopilot", "kind"), [(12, "ODOMETRY"), (3, "VISION_POSITION_ESTIMATE")])
def test_each_autopilot_gets_what_it_wants_once_it_is_heard(autopilot, kind):
    vehicle, checks = MocapVehicle(1, None), PoseChecks(Limits(rate_max_hz=RATE_MAX_HZ))

    def step(at_s):
        passed = checks.step([sample(at_s)], at_s + 0.004, armed=False)
        return kinds(vehicle.step(passed, at_s + 0.004)), checks.problem(at_s + 0.004)

    assert step(0.0)[0] == ["HEARTBEAT"]  # poses are sent only after the vehicle's heartbeat
    vehicle.handle(heartbeat(autopilot), 0.005)
    sent = []
    for i in range(1, 200):
        messages, problem = step(i / 100.0)
        sent += messages
    assert problem is None
    assert sent.count(kind) == pytest.approx(100, abs=3)  # sent at 50 Hz, received at 100 Hz
    assert set(sent) <= {kind, "HEARTBEAT"}
    assert kind not in step(6.0)[0]  # without a heartbeat for 6 s no poses are sent


def test_only_an_autopilot_that_needs_one_gets_an_origin_until_it_shows_it():
    origin = Origin(47.4, 8.5, 430.0)
    for autopilot, wanted in ((12, 0), (3, 5)):
        vehicle = MocapVehicle(1, origin)
        told = []
        for i in range(100):
            if i % 10 == 0:
                vehicle.handle(heartbeat(autopilot), i / 10.0)
            if i == 45:
                vehicle.handle(mav.MAVLink_gps_global_origin_message(1, 2, 3), i / 10.0)
            told += [m for m in vehicle.step([], i / 10.0) if m.get_type() == "SET_GPS_GLOBAL_ORIGIN"]
        assert len(told) == pytest.approx(wanted, abs=1) if wanted else told == []
        assert {(m.latitude, m.altitude) for m in told} <= {(474_000_000, 430_000)}


def test_without_a_pose_the_key_the_endpoint_and_other_keys_are_named():
    endpoint = free_endpoint()
    session, other = zenoh_link.open_session([endpoint]), zenoh_link.open_session([], [endpoint])
    begin = f"mocap: no pose on lab/pose at {endpoint} yet"
    try:
        source = MocapSource(session, SPEC, PoseChecks(), where=[endpoint])
        assert source.problem == begin

        def found():
            other.put("lab/cf2/pose", b"")
            source.poll(0.0, armed=False)
            return source.problem == f"{begin}; there are lab/cf2/pose"

        wait_for(found, "the other key")
        source.poll(0.0, armed=True)
        assert source.problem == begin  # in flight there is no search for other keys
    finally:
        other.close()
        session.close()


def test_why_poses_cannot_be_read_is_known_until_one_can():
    session = zenoh_link.open_session()
    try:
        source = MocapSource(session, SPEC, PoseChecks())
        session.put("lab/pose", b"no pose")
        for now_s in (1.0, 1.002, 1.5, 9.0):  # no further pose arrives
            assert source.poll(now_s, armed=False) == ()
            assert source.problem.startswith("mocap: payload of 7 bytes starts with 6e 6f 20 70")
        session.put("lab/pose", pose_stamped(S, "map", (1.0, 2.0, 0.5)))
        assert len(source.poll(9.1, armed=False)) == 1
        source.poll(12.0, armed=False)
        assert source.problem == "mocap: no pose for 2.9 s"
    finally:
        session.close()


def test_px4s_clock_is_answered():
    vehicle = MocapVehicle(1, None)
    (answer,) = vehicle.handle(mav.MAVLink_timesync_message(0, 77), 2.5)
    assert (answer.tc1, answer.ts1) == (2_500_000_000, 77)
    assert vehicle.handle(mav.MAVLink_timesync_message(1, 77), 2.5) == []
