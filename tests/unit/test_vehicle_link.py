import math
from dataclasses import dataclass
from itertools import pairwise

import pytest

from bridge.autopilots import ARDUPILOT, OWN_SITL, PX4, profile
from bridge.commands import CommandSequencer
from bridge.mavlink import Endpoint, dialect
from bridge.streams import StreamRequests
from bridge.texts import TextAssembler
from bridge.vehicle import COMPONENT_ID, VehicleLink
from bridge.vehicle_state import VehicleState
from flightstack.types import Landed, Mode, Request, VehicleStatus

OFFBOARD, LOITER, TAKEOFF, LAND = 6 << 16, 4 << 16 | 3 << 24, 4 << 16 | 2 << 24, 4 << 16 | 6 << 24
HEIGHT = 1.2


@dataclass(frozen=True)
class Setpoint:
    velocity_enu_m_s: tuple
    yaw_rad: float


def heartbeat(custom_mode=LOITER, *, armed=False, autopilot=12):
    return dialect.MAVLink_heartbeat_message(2, autopilot, 128 if armed else 1, custom_mode, 3, 3)


def position(time_ms=0, x=1.0, y=2.0, z=-3.0, vx=0.1, vy=0.2, vz=-0.3):
    return dialect.MAVLink_local_position_ned_message(time_ms, x, y, z, vx, vy, vz)


def attitude(time_ms=0, yaw=0.0, roll=0.0):
    return dialect.MAVLink_attitude_message(time_ms, roll, 0.0, yaw, 0.0, 0.0, 0.0)


def status(arrival_s=0.0, *, armed=False, mode=Mode.HOLD, landed=Landed.ON_GROUND):
    return VehicleStatus(arrival_s, armed, mode, landed, True)


# --- decoder


@pytest.fixture
def state():
    return VehicleState(PX4)


def test_position_and_attitude_become_own_state_in_enu(state):
    state.update(attitude(990, yaw=math.pi / 2), 4.9)
    state.update(position(1000), 5.0)
    own = state.own
    assert own.position_enu_m == pytest.approx((2.0, 1.0, 3.0))
    assert own.velocity_enu_m_s == pytest.approx((0.2, 0.1, 0.3))
    assert own.yaw_rad == pytest.approx(0.0)
    assert (own.arrival_s, own.source_time_s) == (5.0, pytest.approx(1.0))


def test_no_own_state_without_a_heading(state):
    state.update(position(1000), 5.0)
    assert state.own is None
    assert state.counters.without_yaw == 1


def test_own_state_stops_when_the_heading_stops(state):
    state.update(attitude(1000), 1.0)
    state.update(position(1400), 1.4)
    state.update(position(1600), 1.6)
    assert state.own.arrival_s == 1.4
    assert state.counters.without_yaw == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
@pytest.mark.parametrize("field", ["x", "y", "z", "vx", "vy", "vz"])
def test_position_with_a_bad_number_is_never_used(state, field, value):
    state.update(attitude(1000), 1.0)
    state.update(position(1000), 1.0)
    state.update(position(1010, **{field: value}), 1.01)
    assert state.own.arrival_s == 1.0
    assert state.counters.not_finite == 1


@pytest.mark.parametrize("field", ["yaw", "roll"])
def test_attitude_with_a_bad_number_is_never_used(state, field):
    state.update(attitude(1000, yaw=0.5), 1.0)
    state.update(attitude(1010, **{field: math.nan}), 1.01)
    state.update(position(1010), 1.01)
    assert state.own.yaw_rad == pytest.approx(math.pi / 2 - 0.5)
    assert state.counters.not_finite == 1


@pytest.mark.parametrize("late_ms", [1000, 990, 100])
def test_repeated_and_late_positions_do_not_refresh_the_state(state, late_ms):
    state.update(attitude(1000), 1.0)
    state.update(position(1000), 1.0)
    state.update(position(late_ms, x=9.0), 1.1)
    assert state.own.arrival_s == 1.0
    assert state.counters.out_of_order == 1


def test_a_rebooted_vehicle_is_followed(state):
    state.update(attitude(60_000), 1.0)
    state.update(position(60_000), 1.0)
    state.update(position(100, x=9.0), 2.0)  # no heading of the new life yet
    assert state.own.arrival_s == 1.0
    state.update(attitude(110), 2.01)
    state.update(position(120, x=9.0), 2.02)
    assert state.own.position_enu_m[1] == pytest.approx(9.0)


def test_status_is_put_together_from_three_messages(state):
    state.update(dialect.MAVLink_extended_sys_state_message(0, 2), 0.5)
    assert state.status is None  # without a heartbeat nothing is known
    state.update(heartbeat(OFFBOARD, armed=True), 1.0)
    assert state.status == VehicleStatus(1.0, True, Mode.EXTERNAL, Landed.IN_AIR, False)
    health = dialect.MAV_SYS_STATUS_PREARM_CHECK
    state.update(dialect.MAVLink_sys_status_message(0, 0, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0), 1.5)
    state.update(dialect.MAVLink_extended_sys_state_message(0, 1), 1.6)
    assert state.status == VehicleStatus(1.0, True, Mode.EXTERNAL, Landed.ON_GROUND, True)
    state.update(dialect.MAVLink_extended_sys_state_message(0, 77), 1.7)
    assert state.status.landed is Landed.UNKNOWN


@pytest.mark.parametrize(
    ("custom_mode", "mode"),
    [
        (OFFBOARD, Mode.EXTERNAL),
        (LOITER, Mode.HOLD),
        (TAKEOFF, Mode.TAKEOFF),
        (LAND, Mode.LAND),
        (3 << 16, Mode.OTHER),
    ],
)
def test_px4_modes(state, custom_mode, mode):
    state.update(heartbeat(custom_mode), 0.0)
    assert state.status.mode is mode


def test_ardupilot_modes():
    assert [ARDUPILOT.mode(m) for m in (4, 9, 17, 0)] == [Mode.EXTERNAL, Mode.LAND, Mode.HOLD, Mode.OTHER]


def test_heartbeat_of_another_autopilot_is_no_status(state):
    state.update(heartbeat(4, armed=True, autopilot=3), 0.0)
    assert state.status is None
    assert state.counters.other_autopilot == 1


def test_profile_by_name():
    assert profile("px4") is PX4
    assert profile("sitl") is OWN_SITL
    with pytest.raises(ValueError, match="sitl, px4, ardupilot"):
        profile("betaflight")


# --- sequencer


def sequencer(autopilot=PX4):
    return CommandSequencer(autopilot, 1, 1, HEIGHT)


def commands(messages):
    return [m.command for m in messages]


def params(message):
    return [getattr(message, f"param{i}") for i in range(1, 8)]


def test_nothing_is_sent_for_none_or_to_an_unknown_vehicle():
    s = sequencer()
    assert s.step(Request.NONE, status(), 0.0) == []
    for request in (Request.TAKEOFF, Request.EXTERNAL, Request.LAND):
        assert s.step(request, None, 1.0) == []


def test_takeoff_arms_then_takes_off_then_is_quiet():
    s = sequencer()
    (arm,) = s.step(Request.TAKEOFF, status(0.0), 0.0)
    assert arm.command == 400
    assert params(arm)[:2] == [1.0, 0.0]
    assert (arm.target_system, arm.target_component) == (1, 1)
    (takeoff,) = s.step(Request.TAKEOFF, status(0.1, armed=True), 0.1)
    assert takeoff.command == 22
    assert params(takeoff)[6] == pytest.approx(HEIGHT)
    assert all(math.isnan(p) for p in params(takeoff)[:6])
    assert s.step(Request.TAKEOFF, status(0.2, armed=True, mode=Mode.TAKEOFF), 0.2) == []
    assert s.reached
    # It has climbed and holds: the level is still wanted, and still nothing is sent.
    assert s.step(Request.TAKEOFF, status(9.0, armed=True, landed=Landed.IN_AIR), 9.0) == []


def test_takeoff_height_counts_from_home_above_sea_level_on_px4_only():
    for autopilot, expected in ((PX4, 488.0 + HEIGHT), (ARDUPILOT, HEIGHT)):
        s = sequencer(autopilot)
        s.home_amsl_m = 488.0
        ready = status(0.0, armed=True, mode=Mode.EXTERNAL)
        (takeoff,) = s.step(Request.TAKEOFF, ready, 0.0)
        assert takeoff.command == 22
        assert takeoff.param7 == pytest.approx(expected)


def test_a_vehicle_in_the_air_is_never_told_to_take_off():
    s = sequencer()
    assert s.step(Request.TAKEOFF, status(1.0, armed=True, mode=Mode.OTHER, landed=Landed.IN_AIR), 0.5) == []


def test_commands_are_repeated_every_half_second_and_give_up():
    s = sequencer()
    sent = []
    for tick in range(1000):
        now = tick * 0.01
        sent += [(now, m.confirmation) for m in s.step(Request.LAND, status(now, armed=True), now)]
        if tick == 3:
            s.note_ack(21, 0)  # ACCEPTED, and still the heartbeat never shows it
        if tick == 5:
            s.note_ack(21, 1)
            s.note_ack(400, 4)  # another command's answer
            s.note_text("Landing denied: no position")
    assert [confirmation for _, confirmation in sent] == list(range(10))
    gaps = [b - a for (a, _), (b, _) in pairwise(sent)]
    assert gaps == pytest.approx([0.5] * 9)
    assert "10 tries in 5.0 s" in s.failed
    assert "TEMPORARILY_REJECTED" in s.failed
    assert "no position" in s.failed


def test_a_new_request_clears_the_failure_and_starts_over():
    s = sequencer()
    for tick in range(60):
        s.step(Request.LAND, status(tick * 0.1, armed=True), tick * 0.1)
    assert s.failed is not None
    assert commands(s.step(Request.MOTORS_OFF, status(6.0, armed=True), 6.0)) == [400]
    assert s.failed is None


def test_px4s_first_acknowledgement_proves_nothing():
    s = sequencer()
    for tick in range(100):
        s.note_setpoint(tick * 0.01)
    assert commands(s.step(Request.EXTERNAL, status(1.0, armed=True), 1.0)) == [176]
    s.note_ack(176, 0)
    s.note_ack(176, 1)
    assert not s.reached
    for tick in range(101, 151):
        s.note_setpoint(tick * 0.01)
    assert commands(s.step(Request.EXTERNAL, status(1.2, armed=True), 1.5)) == [176]
    assert s.step(Request.EXTERNAL, status(1.6, armed=True, mode=Mode.EXTERNAL), 1.6) == []
    assert s.reached


def test_external_waits_for_the_stream_and_never_arms():
    s = sequencer()
    first = None
    for tick in range(100):
        now = tick * 0.01
        messages = s.step(Request.EXTERNAL, status(now), now)
        if messages and first is None:
            first = (now, messages)
        if tick >= 20:
            s.note_setpoint(now)
    now, (message,) = first
    assert 0.5 <= now <= 0.52  # 0.3 s after the first set-point
    assert message.command == 176
    assert params(message)[:3] == [1.0, 6.0, 0.0]


def test_an_interrupted_stream_counts_from_its_new_start():
    s = sequencer()
    s.note_setpoint(0.0)
    s.note_setpoint(1.0)
    assert s.step(Request.EXTERNAL, status(1.0), 1.0) == []


def test_mode_changed_by_somebody_else_is_not_fought():
    s = sequencer()
    s.note_setpoint(0.0)
    s.step(Request.EXTERNAL, status(0.5, armed=True, mode=Mode.EXTERNAL), 0.4)
    assert s.reached
    for tick in range(200):
        now = 1.0 + tick * 0.01
        s.note_setpoint(now)
        assert s.step(Request.EXTERNAL, status(now, armed=True, mode=Mode.OTHER), now) == []


def test_an_old_heartbeat_does_not_prove_a_new_request():
    s = sequencer()
    old = status(0.0, armed=True, mode=Mode.LAND)
    assert s.step(Request.LAND, old, 0.5) == []
    assert not s.reached
    assert commands(s.step(Request.LAND, status(0.6, armed=True, mode=Mode.EXTERNAL), 0.6)) == [21]


def test_motors_off_is_forced_and_sent_even_blind():
    s = sequencer()
    (kill,) = s.step(Request.MOTORS_OFF, None, 0.0)
    assert kill.command == 400
    assert params(kill)[:2] == [0.0, 21196.0]
    assert s.step(Request.MOTORS_OFF, status(0.2), 0.2) == []
    assert s.reached


def test_land_and_motors_off_need_nothing_on_a_disarmed_vehicle():
    for request in (Request.LAND, Request.MOTORS_OFF):
        assert sequencer().step(request, status(), 0.0) == []


def test_ardupilot_switches_to_guided_before_it_arms_and_sends_no_nan():
    s = sequencer(ARDUPILOT)
    sent = s.step(Request.TAKEOFF, status(0.0), 0.0)
    sent += s.step(Request.TAKEOFF, status(0.1, mode=Mode.EXTERNAL), 0.1)
    sent += s.step(Request.TAKEOFF, status(0.2, mode=Mode.EXTERNAL, armed=True), 0.2)
    assert commands(sent) == [176, 400, 22]
    assert params(sent[0])[:2] == [1.0, 4.0]
    assert not any(math.isnan(p) for m in sent for p in params(m))


@pytest.mark.parametrize("height", [0.0, -1.0, math.nan, math.inf])
def test_senseless_takeoff_height_is_refused(height):
    with pytest.raises(ValueError, match="take-off height"):
        CommandSequencer(PX4, 1, 1, height)


# --- requests for telemetry


def test_streams_are_asked_for_again_only_while_they_do_not_come():
    streams = StreamRequests({32: 100.0, 30: 100.0}, 1, 1, 0.0)
    asked = {32: 0, 30: 0}
    for tick in range(2000):
        for m in streams.step(tick * 0.01):
            assert (m.command, m.param2) == (511, 10_000.0)
            asked[int(m.param1)] += 1
        streams.seen(32)  # at the rate wanted
        if tick % 4 == 0:
            streams.seen(30)  # at a quarter of it
    assert asked == {32: 1, 30: 5}


def test_a_stream_that_stops_is_asked_for_again():
    streams = StreamRequests({32: 50.0}, 1, 1, 0.0)
    asked = []
    for tick in range(1000):
        asked += [tick * 0.02 for _ in streams.step(tick * 0.02)]
        if tick < 500:
            streams.seen(32)
    assert len(asked) == 5
    assert asked[0] == 0.0
    assert all(t > 10.0 for t in asked[1:])


# --- texts


def test_long_texts_are_put_together():
    texts = TextAssembler()
    text = "Preflight Fail: " + "x" * 60 + "\t"
    add = [
        texts.add(dialect.MAVLink_statustext_message(3, text[i : i + 50].encode(), 7, n))
        for n, i in enumerate((0, 50))
    ]
    assert add == [[], [(3, text.strip())]]
    assert texts.add(dialect.MAVLink_statustext_message(6, b"short\x1b[2J", 0, 0)) == [(6, "short [2J")]


def test_a_text_that_breaks_off_is_shown_with_a_mark():
    texts = TextAssembler()
    assert texts.add(dialect.MAVLink_statustext_message(3, b"a" * 50, 7, 0)) == []
    assert texts.add(dialect.MAVLink_statustext_message(6, b"next", 0, 0)) == [
        (3, "a" * 50 + " ..."),
        (6, "next"),
    ]


# --- the link, over real sockets


class FakeAutopilot:
    """Listens on UDP, answers nothing by itself; a test says what it sends and looks at what came."""

    def __init__(self, system_id=1, component_id=1):
        self.endpoint = Endpoint("udpin:127.0.0.1:0", system_id, component_id)
        self.armed = False
        self.mode = LOITER

    def send(self, *messages, peer=None):
        self.endpoint.send(messages, peer)

    def beat(self):
        self.send(heartbeat(self.mode, armed=self.armed))

    def take(self, until):
        """Everything up to and with the first message of type ``until``."""
        received = []
        while not any(m.get_type() == until for m in received):
            assert self.endpoint.wait(5.0), f"no {until} came"
            received += [r.message for r in self.endpoint.receive()]
        return received


@pytest.fixture
def vehicle():
    fake = FakeAutopilot()
    yield fake
    fake.endpoint.close()


@pytest.fixture
def link(vehicle):
    opened = VehicleLink(f"udpout:127.0.0.1:{vehicle.endpoint.local_port}", takeoff_height_m=HEIGHT)
    opened.poll(0.0)  # says hello, so that the vehicle knows where we are
    vehicle.take("HEARTBEAT")
    yield opened
    opened.close()


def poll(link, now_s):
    assert link.endpoint.wait(5.0)
    link.poll(now_s)


def test_hello_is_a_companions_heartbeat(vehicle):
    link = VehicleLink(f"udpout:127.0.0.1:{vehicle.endpoint.local_port}", takeoff_height_m=HEIGHT)
    link.poll(0.0)
    (hello,) = vehicle.take("HEARTBEAT")
    assert (hello.type, hello.autopilot) == (18, 8)
    assert (hello.get_srcSystem(), hello.get_srcComponent()) == (1, COMPONENT_ID)
    assert not link.heard
    link.close()


def test_state_and_status_come_through(vehicle, link):
    vehicle.send(heartbeat(LOITER), attitude(500), position(500))
    poll(link, 2.0)
    assert link.own.position_enu_m == pytest.approx((2.0, 1.0, 3.0))
    assert link.own.arrival_s == 2.0
    assert link.status.mode is Mode.HOLD
    assert link.heard


@pytest.mark.parametrize("ids", [(2, 1), (1, 190), (255, 190)])
def test_others_are_counted_and_ignored(link, ids):
    other = Endpoint(f"udpout:127.0.0.1:{link.endpoint.local_port}", *ids)
    other.send([heartbeat(OFFBOARD, armed=True), attitude(1), position(1)])
    poll(link, 1.0)
    other.close()
    assert (link.own, link.status, link.heard) == (None, None, False)
    assert link.counters.foreign == 3


def test_telemetry_is_asked_for_once_the_vehicle_is_heard(vehicle, link):
    vehicle.beat()
    poll(link, 1.0)
    link.flush()
    asked = {m.param1: m.param2 for m in vehicle.take("COMMAND_LONG") if m.get_type() == "COMMAND_LONG"}
    assert asked == {32.0: 10_000.0, 30.0: 10_000.0, 245.0: 200_000.0}


def test_own_heartbeat_goes_out_once_a_second(vehicle, link):
    count = 0
    for tick in range(301):
        vehicle.send(position(tick * 10))
        poll(link, tick * 0.01)
        link.flush([dialect.MAVLink_ping_message(0, 0, 0, 0)])
        count += sum(m.get_type() == "HEARTBEAT" for m in vehicle.take("PING"))
    assert count == 4


def test_setpoint_on_the_wire(vehicle, link):
    assert link.send_setpoint(Setpoint((0.1, 0.2, 0.3), 0.0), now_s=1.2345)
    link.flush()
    (m,) = vehicle.take("SET_POSITION_TARGET_LOCAL_NED")
    assert (m.coordinate_frame, m.type_mask, m.time_boot_ms) == (1, 2503, 1234)
    assert (m.target_system, m.target_component) == (1, 1)
    assert (m.vx, m.vy, m.vz) == pytest.approx((0.2, 0.1, -0.3))
    assert m.yaw == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_setpoint_that_is_not_finite_never_leaves(link, bad):
    assert not link.send_setpoint(Setpoint((0.0, bad, 0.0), 0.0), 0.0)
    assert not link.send_setpoint(Setpoint((0.0, 0.0, 0.0), bad), 0.0)
    assert link.counters.setpoints_refused == 2


def test_nothing_is_sent_twice(vehicle, link):
    link.send_setpoint(Setpoint((0.1, 0.0, 0.0), 0.0), 0.0)
    link.flush()
    link.flush([dialect.MAVLink_ping_message(0, 0, 0, 0)])
    types = [m.get_type() for m in vehicle.take("PING")]
    assert types == ["SET_POSITION_TARGET_LOCAL_NED", "PING"]


def test_everything_of_a_tick_is_one_datagram(vehicle, link):
    vehicle.beat()
    poll(link, 1.0)
    link.command(Request.LAND, 1.0)
    link.send_setpoint(Setpoint((0.0, 0.0, 0.0), 0.0), 1.0)
    link.flush([link.timesync_reply(10)])
    assert vehicle.endpoint.wait(5.0)
    assert vehicle.endpoint._socket.recvfrom(65536)[0].count(b"\xfd") >= 5
    assert vehicle.endpoint.receive() == []


def test_ardupilot_gets_no_setpoint_while_it_takes_off(vehicle):
    link = VehicleLink(
        f"udpout:127.0.0.1:{vehicle.endpoint.local_port}", takeoff_height_m=HEIGHT, profile=ARDUPILOT
    )
    link.command(Request.TAKEOFF, 0.0)
    assert not link.send_setpoint(Setpoint((0.0, 0.0, 0.0), 0.0), 0.0)
    link.command(Request.EXTERNAL, 1.0)
    assert link.send_setpoint(Setpoint((0.0, 0.0, 0.0), 0.0), 1.0)
    link.close()


def test_a_flight_from_arming_to_motors_off(vehicle, link):
    """The fake autopilot obeys, with PX4's double answer and one lost command each."""
    lost = set()
    now = 0.0

    def obey(m):
        if m.get_type() != "COMMAND_LONG" or m.command == 511:
            return
        key = (m.command, str(m.param1))
        if key not in lost:
            lost.add(key)
            return
        vehicle.send(*(dialect.MAVLink_command_ack_message(m.command, 0) for _ in range(2)))
        if m.command == 400:
            vehicle.armed = m.param1 == 1.0
        vehicle.mode = {176: OFFBOARD, 22: TAKEOFF, 21: LAND}.get(m.command, vehicle.mode)
        vehicle.beat()

    for request, reached in (
        (Request.TAKEOFF, lambda: link.status.mode is Mode.TAKEOFF),
        (Request.EXTERNAL, lambda: link.status.mode is Mode.EXTERNAL),
        (Request.LAND, lambda: link.status.mode is Mode.LAND),
        (Request.MOTORS_OFF, lambda: not link.status.armed),
    ):
        deadline = now + 4.0
        while link.status is None or not reached():
            assert now < deadline, request
            vehicle.send(position(round(now * 1000)))
            poll(link, now)
            link.command(request, now)
            link.send_setpoint(Setpoint((0.0, 0.0, 0.0), 0.0), now)
            link.flush()
            for message in vehicle.take("SET_POSITION_TARGET_LOCAL_NED"):
                obey(message)
            if round(now * 100) % 100 == 0:
                vehicle.beat()
            now += 0.01
        assert link.failed is None


def test_texts_are_handed_over_once(vehicle, link):
    vehicle.send(dialect.MAVLink_statustext_message(4, b"low battery", 0, 0))
    poll(link, 0.0)
    assert link.take_texts() == [(4, "low battery")]
    assert link.take_texts() == []


def test_a_refusal_is_explained(vehicle, link):
    for tick in range(600):
        now = tick * 0.01
        vehicle.send(
            heartbeat(),
            dialect.MAVLink_command_ack_message(400, 1),
            dialect.MAVLink_statustext_message(2, b"no GPS", 0, 0),
        )
        poll(link, now)
        link.command(Request.TAKEOFF, now)
    assert link.failed is not None
    assert "arm (command 400)" in link.failed
    assert "TEMPORARILY_REJECTED" in link.failed
    assert "no GPS" in link.failed


def test_wrong_profile_is_said_aloud_once(vehicle, link):
    for _ in range(2):
        vehicle.send(heartbeat(4, autopilot=3))
        poll(link, 0.0)
    ((severity, text),) = link.take_texts()
    assert severity == 3
    assert "autopilot 3" in text
    assert link.status is None


def test_timesync_is_answered_at_once_in_real_time(vehicle, link):
    vehicle.send(dialect.MAVLink_timesync_message(0, 123), dialect.MAVLink_timesync_message(9, 5))
    poll(link, 2.5)
    (reply,) = vehicle.take("TIMESYNC")
    assert (reply.tc1, reply.ts1) == (2_500_000_000, 123)
    assert link.take_timesync() is None


def test_lockstep_stamps_what_came_with_the_time_of_the_request(vehicle):
    link = VehicleLink(
        f"udpout:127.0.0.1:{vehicle.endpoint.local_port}", takeoff_height_m=HEIGHT, defer_timesync=True
    )
    link.poll(0.0)
    vehicle.take("HEARTBEAT")
    vehicle.send(heartbeat(), attitude(30), position(30))
    poll(link, 77.0)
    assert link.own is None  # no tick has claimed it yet
    vehicle.send(dialect.MAVLink_timesync_message(0, 30_000_000))
    poll(link, 77.0)
    assert link.own.arrival_s == 30_000_000 / 1e9
    assert link.status.arrival_s == 30_000_000 / 1e9
    assert link.take_timesync() == 30_000_000
    assert link.take_timesync() is None
    link.flush([link.timesync_reply(30_000_000)])
    sent = vehicle.take("TIMESYNC")
    assert (sent[-1].tc1, sent[-1].ts1) == (30_000_001, 30_000_000)
    link.close()


def test_lockstep_holds_a_bounded_number_of_messages(vehicle):
    link = VehicleLink(
        f"udpout:127.0.0.1:{vehicle.endpoint.local_port}", takeoff_height_m=HEIGHT, defer_timesync=True
    )
    link.poll(0.0)
    vehicle.take("HEARTBEAT")
    batch = [position(i) for i in range(30)]
    for _ in range(200):
        vehicle.send(*batch)
        poll(link, 0.0)
    assert link.counters.held_lost == 6000 - 4096
    link.close()


def test_link_follows_a_vehicle_that_comes_back_on_another_port(vehicle, link):
    vehicle.beat()
    poll(link, 0.0)
    other = FakeAutopilot()
    other.send(heartbeat(), peer=("127.0.0.1", link.endpoint.local_port))
    poll(link, 0.1)
    link.send_setpoint(Setpoint((0.0, 0.0, 0.0), 0.0), 0.1)
    link.flush()
    assert other.take("SET_POSITION_TARGET_LOCAL_NED")
    other.endpoint.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [({"url": "serial:/dev/x"}, "udpin"), ({"rate_hz": 0.0}, "loop rate"), ({"system_id": 0}, "1 to 255")],
)
def test_bad_arguments_are_refused(arguments, words):
    values = {"url": "udpin:127.0.0.1:0", "takeoff_height_m": HEIGHT} | arguments
    with pytest.raises(ValueError, match=words):
        VehicleLink(values.pop("url"), **values)
