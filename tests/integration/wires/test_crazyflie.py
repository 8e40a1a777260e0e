"""Tests the process of the Crazyflie bridge over the UDP driver of cflib."""

from __future__ import annotations

import signal
import subprocess
import time

import pytest

from bridge.crazyflie.link import EVENTS_MAX, CrazyflieLink
from bridge.crazyflie.packets import Connected, LogPacket, Lost
from bridge.zenoh import zenoh_link
from flightstack.common.processes import ended
from tests.crazyflie_firmware.firmware import Firmware
from tests.crazyflie_firmware.server import Server
from tests.crazyflie_firmware.sim_plant import SimPlant
from tests.crazyflie_firmware.supervisor import PERIOD_S, TIMEOUT_S, State
from tests.integration.runs import COMMAND, called
from tests.integration.sim_processes import ROOT, is_a, priority_or_skip, prompt_threads
from tests.integration.wires.bridge_processes import KEY, Mocap, bridge, client, fly, verb
from tests.processes.bounded import wait_for
from tests.processes.ports import free_endpoint

pytestmark = pytest.mark.xdist_group("real-time")

LAND = 0x06040000
TABLES = (567, 334)  # numbers of log variables and parameters in firmware 2026.08


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
            assert landed.returncode == 0, landed.stdout + landed.stderr + "\n".join(started.lines)
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


def test_without_a_radio_a_line_says_what_to_do():
    with verb("crazyflie", "--uri", "radio://DEADBEEF00/80/2M", "--url", "udpin:127.0.0.1:0") as started:
        line = "Cannot find radio with serial DEADBEEF00: plug it in; on Linux install Bitcraze's udev rules"
        started.until(f"crazyflie: {line}")
        assert started.end(signal.SIGTERM) == 0


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
            prompt = prompt_threads(started.process.pid)
            assert started.process.pid in prompt
            assert len(prompt) > 1


def test_connects_over_a_radio_that_loses_every_tenth_packet_of_the_real_tables():
    with (
        Server(Firmware(tables=TABLES), loss=0.1, seed=4) as server,
        bridge(server) as started,
        client(started) as one,
    ):
        one.until(is_a("HEARTBEAT"), timeout_s=90.0, each=one.hello)
        fly(one, server)
        assert server.lost > 20


def stays_unlocked(server):
    """Assert that the supervisor is not locked after the time at which missing set-points would lock it."""
    ended_s = server.now_s
    wait_for(lambda: server.now_s > ended_s + TIMEOUT_S + 2 * PERIOD_S, "the end of the watchdog's time")
    wait_for(lambda: server.firmware.supervisor.state in (State.CHECKS_PASSED, State.READY), "readiness")
    assert State.LOCKED not in [state for _, state in server.firmware.supervisor.history]


def test_told_twice_to_end_it_stops_the_motors_at_once():
    with Server(Firmware()) as server, bridge(server) as started, client(started) as one:
        fly(one, server)
        started.process.send_signal(signal.SIGINT)
        one.until(is_a("HEARTBEAT", custom_mode=LAND))
        assert started.end(signal.SIGINT) == 0
        wait_for(lambda: not server.firmware.plant.motors, "motors off")  # the last packets may be delayed
        stays_unlocked(server)


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
            assert [type(event) for _, event in events] == [Lost]
            assert events[0][1].reason.startswith("no answer from udp://")
        finally:
            link.close()


def test_what_nobody_takes_is_bounded(tmp_path):
    with Server(Firmware()) as server:
        link = CrazyflieLink(server.uri, tmp_path)
        try:
            wait_for(lambda: len(link._events) == EVENTS_MAX, "more events than there is room for")
            time.sleep(0.5)  # time for about 60 more events
            events = [event for _, event in link.poll()]
            assert len(events) <= EVENTS_MAX
            assert Connected not in {type(event) for event in events}  # the oldest event was dropped
            times_ms = [
                event.time_ms for event in events if isinstance(event, LogPacket) and event.block == "state"
            ]
            assert times_ms == sorted(times_ms)
            assert link.poll() == [] or len(link.poll()) < 5
            assert any(tmp_path.iterdir())  # the link has stored the tables in its cache
        finally:
            link.close()


REFUSED = [
    *(
        (uri, "udpin:127.0.0.1:0", f"Crazyflie URI {uri!r} is not understood: allowed is radio://DONGLE/")
        for uri in ("mailto:nobody", "radio://", "udp://host", "radio://0/80/3M")
    ),
    ("udp://127.0.0.1:9", "udpin:0.0.0.0:0", "--signing-key FILE"),  # a network address requires a key
]


@pytest.mark.parametrize(("uri", "url", "said"), REFUSED)
def test_a_wrong_uri_or_an_open_network_is_refused_with_what_is_allowed(uri, url, said):
    done = called("bridge", "crazyflie", "--uri", uri, "--url", url)
    assert done.code == 2
    assert said in done.err
