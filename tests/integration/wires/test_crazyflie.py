"""The Crazyflie bridge as a process, through cflib's own UDP driver."""

from __future__ import annotations

import signal
import subprocess
import threading
import time

import pytest

from bridge.crazyflie.link import EVENTS_MAX, CrazyflieLink
from bridge.crazyflie.types import Connected, Lost, StateBlock
from bridge.target.odometry import OdometryPublisher
from bridge.zenoh import zenoh_link
from flightstack.common.processes import ended
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.plant import Point
from tests.crazyflie_firmware.server import Server
from tests.crazyflie_firmware.sim_plant import SimPlant
from tests.crazyflie_firmware.supervisor import PERIOD_S, TIMEOUT_S, State
from tests.integration.runs import COMMAND, called
from tests.integration.sim_processes import (
    NAN,
    PATIENCE_S,
    ROOT,
    is_a,
    priority_or_skip,
    prompt_threads,
    setpoint,
    wait_for,
)
from tests.integration.wires.bridge_processes import KEY, Mocap, bridge, client, fly, verb
from tests.processes.ports import free_endpoint

pytestmark = pytest.mark.xdist_group("real-time")

ARMED, LAND, HOLD = 128, 0x06040000, 0x03040000
HIGH_M, TABLES = 1.5, (567, 334)  # m; entries of firmware 2026.08's tables of logs and parameters
PAD_M, PAD_RADIUS_M = 0.2, 0.15
SENT = 50  # set-points of a client that then stops
CONFIG = """
filter = "paper"
[barrier]
alpha_1_m = 1.0
beta_m = 1.5
[limits]
velocity_max_m_s = [0.3, 0.3, 0.5]
[touchdown]
rule = "paper"
height_m = 0.05
[takeoff]
height_m = 0.6
"""


def test_the_onboard_process_lands_it_unchanged(tmp_path):
    plant = Point(-1.2, 0.3, lambda x, y: PAD_M if x * x + y * y < PAD_RADIUS_M**2 else 0.0)
    config = tmp_path / "onboard.toml"
    config.write_text(CONFIG)
    endpoint = free_endpoint()
    session = zenoh_link.open_session([endpoint])
    target = OdometryPublisher(session, "cf1/target/odom", frame_id="map", child_frame_id="target")
    done = threading.Event()

    def publish() -> None:
        while not done.wait(0.02):
            now_ns = time.time_ns()
            zeros = (0.0, 0.0, 0.0)
            target.put(target.encode(now_ns, (0.0, 0.0, PAD_M), (1.0, 0.0, 0.0, 0.0), zeros, zeros), now_ns)

    publisher = threading.Thread(target=publish, daemon=True)
    publisher.start()
    try:
        with Server(Firmware(plant)) as server, bridge(server) as started:
            landed = subprocess.run(
                [*COMMAND, "onboard", "--vehicle", started.url.replace("udpin", "udpout"),
                 "--config", str(config), "--connect", endpoint, "--duration", "90"],
                cwd=ROOT, capture_output=True, text=True, timeout=150.0, check=False,
            )  # fmt: skip
            assert landed.returncode == 0, landed.stdout + landed.stderr + "".join(started.lines)
            assert "LANDED: motors off" in landed.stdout
            x, y, z = plant.position
            assert (x * x + y * y) ** 0.5 < PAD_RADIUS_M
            assert z == pytest.approx(PAD_M)
            assert not plant.motors
            assert {"stop", "notify", "disarm"} <= {what for _, what in server.firmware.legs}
            history = [state for _, state in server.firmware.supervisor.history]
            assert State.LOCKED not in history
            assert started.end() == 0
    finally:
        done.set()
        publisher.join(PATIENCE_S)
        session.close()


def test_the_simulated_physics_land_on_the_moving_robot_through_cflib(tmp_path):
    here, there = (free_endpoint() for _ in range(2))
    robot = subprocess.Popen(
        [*COMMAND, "target", "--scenario", "paper_moving_1", "--listen", here, "--connect", there],
        cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    session = zenoh_link.open_session([], [here])
    try:
        plant = SimPlant("paper_moving_1", 1, session)
        with Server(Firmware(plant)) as server, bridge(server) as started:
            landed = subprocess.run(
                [*COMMAND, "onboard", "--vehicle", started.url.replace("udpin", "udpout"), "--connect", here,
                 "--listen", there, "--config", "crazyflie", "--no-record", "--duration", "120"],
                cwd=ROOT, capture_output=True, text=True, timeout=180.0, check=False,
            )  # fmt: skip
            assert landed.returncode == 0, landed.stdout + landed.stderr + "".join(started.lines)
            assert "LANDED: motors off" in landed.stdout
            wait_for(lambda: plant.vehicle.on_pad, "contact with the pad")
            assert not plant.motors
            assert State.LOCKED not in [state for _, state in server.firmware.supervisor.history]
            truth = plant.vehicle.truth()
            offset = [a - b for a, b in zip(truth.position_enu_m, truth.pad_position_enu_m, strict=True)]
            assert (offset[0] ** 2 + offset[1] ** 2) ** 0.5 < 0.1
    finally:
        session.close()
        ended(robot)


def test_it_has_the_system_id_of_a_member_of_a_fleet():
    with Server(Firmware()) as server, bridge(server, "--system-id", "3") as started, client(started) as one:
        heartbeat = one.until(is_a("HEARTBEAT"), each=one.hello)
        assert heartbeat.get_srcSystem() == 3


@pytest.mark.parametrize("kind", ["crazyflie", "mocap"])
def test_a_bridge_and_its_threads_wait_for_no_other_program(kind):
    priority_or_skip()
    still = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    with Server(Firmware()) as server, Mocap(KEY, lambda: still) as mocap:
        words = {
            "crazyflie": ("--uri", server.uri, "--url", "udpin:127.0.0.1:0"),
            "mocap": ("--key", KEY, "--connect", mocap.endpoint, "--vehicle", "udpin:127.0.0.1:0"),
        }
        with verb(kind, *words[kind]) as started:
            prompt = prompt_threads(started.child.pid)
            assert started.child.pid in prompt
            assert len(prompt) > 1


def test_set_points_stop_with_their_client_and_the_firmware_does_the_rest():
    with Server(Firmware()) as server, bridge(server) as started, client(started) as one:
        fly(one, server)
        firmware = server.firmware
        for _ in range(SENT):  # a client at some 50 Hz
            one.send(setpoint(0.2))
            one.receive(0.02)
        wait_for(lambda: firmware.supervisor.state is State.LOCKED, "the lock")
        last_s, last_m_s, _ = firmware.setpoints[-1]
        assert last_m_s[1] == pytest.approx(0.2), "nothing is made up after the client's last one"
        passed = sum(velocity == last_m_s for _, velocity, _ in firmware.setpoints)
        assert 0 < passed <= SENT, "each goes to the radio once"
        history = {state: at_s - last_s for at_s, state in firmware.supervisor.history}
        assert history[State.LEVEL_OUT] == pytest.approx(0.54, abs=0.1)
        assert history[State.LOCKED] == pytest.approx(2.08, abs=0.2)
        wait_for(lambda: started.said("supervisor has locked: restart the Crazyflie"), "the reason")
        one.until(lambda m: is_a("HEARTBEAT")(m) and not m.base_mode & ARMED)
        one.send(one.command(400, 1.0))
        assert one.until(is_a("COMMAND_ACK", command=400)).result == 1


def test_flight_termination_stops_the_motors_within_a_few_packets():
    with Server(Firmware()) as server, bridge(server) as started, client(started) as one:
        fly(one, server)
        sent_s = server.now_s
        one.send(one.command(185, 1.0))
        assert one.until(is_a("COMMAND_ACK", command=185)).result == 0
        wait_for(lambda: not server.firmware.plant.motors, "motors off")
        assert server.now_s - sent_s < 0.5
        assert "emergency" in [what for _, what in server.firmware.legs]
        wait_for(lambda: server.firmware.supervisor.state is State.LOCKED, "the lock")


def test_a_silent_radio_ends_the_heartbeat_within_its_bound_and_comes_back():
    with Server(Firmware()) as server, bridge(server) as started, client(started) as one:
        one.until(is_a("HEARTBEAT"))
        one.until(is_a("LOCAL_POSITION_NED"))
        server.mute = server.deaf = True
        silent_s = time.monotonic()
        last_s: dict[str, float] = {}
        while time.monotonic() < silent_s + 4.5:
            for message in one.receive(0.05):
                last_s[message.get_type()] = time.monotonic() - silent_s
            one.hello()
        assert last_s.get("LOCAL_POSITION_NED", 0.0) < 0.3
        assert last_s.get("HEARTBEAT", 0.0) < 1.3
        assert started.said("Radio silent for 0.5 s")
        assert started.said("Radio lost: nothing heard for 3 s")
        server.mute = server.deaf = False
        one.log.clear()
        one.until(is_a("HEARTBEAT"), each=one.hello)
        assert started.end() == 0


@pytest.mark.parametrize("gap", ["1.3 s of silence, both ways", "4.5 s without telemetry", "restart"])
def test_after_a_gap_in_its_own_mode_it_stands_with_the_motors_off(gap):
    with Server(Firmware()) as server, bridge(server) as started, client(started) as one:
        fly(one, server)
        firmware = server.firmware
        one.send(one.command(22, *[NAN] * 6, HIGH_M))
        high = lambda: firmware.plant.position[2] > HIGH_M - 0.1  # noqa: E731
        one.until(lambda m: is_a("HEARTBEAT", custom_mode=HOLD)(m) and high(), each=one.hello)
        if gap == "restart":
            firmware.restart()
        else:
            server.mute, server.deaf = True, "both" in gap
            since_s, seconds = server.now_s, float(gap.partition(" ")[0])
            wait_for(lambda: one.hello() or server.now_s - since_s > seconds, "the end of the gap")
            server.mute = server.deaf = False
        text = "it restarted" if gap == "restart" else "Landed, disarmed"
        wait_for(lambda: one.hello() or started.said(text), text)
        one.log.clear()
        one.until(lambda m: is_a("HEARTBEAT")(m) and not m.base_mode & ARMED, each=one.hello)
        assert firmware.plant.on_surface
        stays_unlocked(server)
        assert not firmware.plant.motors


def test_connects_over_a_radio_that_loses_every_tenth_packet_of_the_real_tables():
    with (
        Server(Firmware(tables=TABLES), loss=0.1, seed=4) as server,
        bridge(server) as started,
        client(started) as one,
    ):
        one.until(is_a("HEARTBEAT"), timeout_s=90.0, each=one.hello)
        fly(one, server)
        assert server.lost > 20


def test_firmware_without_a_log_variable_is_refused_by_its_version():
    with Server(Firmware(protocol=7, auto_arm=False)) as server, bridge(server) as started:
        wait_for(lambda: started.said("firmware speaks CRTP 7, arming by supervisor needs 12"), "the reason")


def test_old_firmware_is_refused_with_the_version_needed():
    with (
        Server(Firmware(protocol=9, auto_arm=False)) as server,
        bridge(server) as started,
        client(started) as one,
    ):
        one.until(is_a("HEARTBEAT"), each=one.hello)
        one.send(one.command(400, 1.0))
        assert one.until(is_a("COMMAND_ACK", command=400)).result == 1
        wait_for(lambda: started.said("firmware speaks CRTP 9, arming by supervisor needs 12"), "the reason")
        assert not server.firmware.supervisor.armed


def test_told_to_end_in_the_air_it_lands_first_and_leaves_it_ready_to_fly():
    with Server(Firmware()) as server, bridge(server) as started, client(started) as one:
        fly(one, server)
        assert started.end() == 0
        assert server.firmware.plant.on_surface
        stays_unlocked(server)


def stays_unlocked(server):
    """Wait until the supervisor would have locked for want of set-points; it can be armed, or is."""
    ended_s = server.now_s
    wait_for(lambda: server.now_s > ended_s + TIMEOUT_S + 2 * PERIOD_S, "the end of the watchdog's time")
    wait_for(lambda: server.firmware.supervisor.state in (State.CHECKS_PASSED, State.READY), "readiness")
    assert State.LOCKED not in [state for _, state in server.firmware.supervisor.history]


def test_told_twice_to_end_it_stops_the_motors_at_once():
    with Server(Firmware()) as server, bridge(server) as started, client(started) as one:
        fly(one, server)
        started.child.send_signal(signal.SIGINT)
        one.until(is_a("HEARTBEAT", custom_mode=LAND))
        assert started.end(signal.SIGINT) == 0
        wait_for(lambda: not server.firmware.plant.motors, "motors off")  # last packets may be queued
        stays_unlocked(server)


def test_nobody_there_is_said_and_it_ends_when_told(tmp_path):
    with Server(Firmware()) as server:
        server.mute = True
        with bridge(server, "--cache", str(tmp_path / "cache")) as started:
            wait_for(lambda: started.said("no answer from udp://"), "the reason")
            assert started.end(signal.SIGINT) == 0


def test_log_blocks_of_an_earlier_connection_are_no_answer():
    firmware = Firmware()
    firmware.packet(b"\x5d\x06\x01" + bytes((0x55, 0, 0)), 0.0)
    firmware.packet(b"\x5d\x03\x01\x01", 0.0)
    firmware.packet = lambda raw, now_s: []
    with Server(firmware) as server:
        link = CrazyflieLink(server.uri)
        try:
            events = []
            wait_for(lambda: events.extend(link.poll()) or len(events) > 0, "the end of the attempt")
            assert [type(arrived.event) for arrived in events] == [Lost]
            assert events[0].event.reason.startswith("no answer from udp://")
        finally:
            link.close()


def test_what_nobody_takes_is_bounded(tmp_path):
    with Server(Firmware()) as server:
        link = CrazyflieLink(server.uri, tmp_path)
        try:
            wait_for(lambda: link.events_lost > 50, "more events than there is room for")
            events = [arrived.event for arrived in link.poll()]
            assert len(events) <= EVENTS_MAX
            assert Connected not in {type(event) for event in events}  # the oldest went first
            times_ms = [event.time_ms for event in events if isinstance(event, StateBlock)]
            assert times_ms == sorted(times_ms)
            assert link.poll() == [] or len(link.poll()) < 5
            assert any(tmp_path.iterdir())  # the tables are kept
        finally:
            link.close()


REFUSED = [
    *(
        (uri, "udpin:127.0.0.1:0", f"Crazyflie URI {uri!r} is not understood: allowed is radio://DONGLE/")
        for uri in ("mailto:nobody", "radio://", "udp://host", "radio://0/80/3M")
    ),
    ("udp://127.0.0.1:9", "udpin:0.0.0.0:0", "--signing-key FILE"),  # a network only with a key
]


@pytest.mark.parametrize(("uri", "url", "said"), REFUSED)
def test_a_wrong_uri_or_an_open_network_is_refused_with_what_is_allowed(uri, url, said):
    done = called("bridge", "crazyflie", "--uri", uri, "--url", url)
    assert done.code == 2
    assert said in done.err
