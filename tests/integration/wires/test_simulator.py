"""The processes of vehicle and target on their real wires: real time with plain clients, and lockstep."""

from __future__ import annotations

import itertools
import math
import os
import re
import signal
import struct
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.target.odometry import OdometryPublisher, decode_odometry
from bridge.zenoh import zenoh_link
from flightstack.common.pacing import ask_for_priority, give_up_priority
from flightstack.core.types import ZERO, Phase
from logs.schema.rows import ControllerStepRow
from tests.integration.sim_processes import (
    PATIENCE_S,
    Client,
    free_port,
    is_a,
    process,
    setpoint,
    terminate,
    wait_for,
)

ARMED = 128
OFFBOARD, TAKEOFF, HOLD, LAND = 0x00060000, 0x02040000, 0x03040000, 0x06040000
RATE_HZ = 100


def vehicle(seed: int, *, lockstep: bool, url: str = "udpin:127.0.0.1:0", **more):
    return process("vehicle", seed=seed, url=url, lockstep=lockstep, rate_hz=RATE_HZ, **more)


def test_flies_in_real_time_with_a_plain_client() -> None:
    with vehicle(1, lockstep=False) as (child, ready):
        client = Client(ready.removeprefix("ready "))
        client.hello()
        beat = client.until(is_a("HEARTBEAT"))
        assert (beat.autopilot, beat.base_mode & ARMED) == (mav.MAV_AUTOPILOT_PX4, 0)
        client.send(client.command(176, 1.0, 6.0))
        assert client.until(is_a("COMMAND_ACK", command=176)).result == 1
        assert "no set-points" in client.until(is_a("STATUSTEXT")).text
        client.send(client.command(400, 1.0), client.command(22))
        assert client.until(is_a("COMMAND_ACK", command=400)).result == 0
        assert client.until(is_a("COMMAND_ACK", command=22)).result == 0
        client.until(is_a("HEARTBEAT", custom_mode=TAKEOFF, base_mode=29 | ARMED))
        client.until(is_a("HEARTBEAT", custom_mode=HOLD))
        high = client.until(is_a("LOCAL_POSITION_NED"))
        assert -high.z == pytest.approx(0.5, abs=0.08)
        client.send(client.command(400, 0.0))
        assert client.until(is_a("COMMAND_ACK", command=400)).result == 1  # not in the air

        north = [setpoint(0.3)]
        client.send(*north, client.command(176, 1.0, 6.0))
        assert client.until(is_a("COMMAND_ACK", command=176)).result == 0
        client.until(
            lambda m: is_a("LOCAL_POSITION_NED")(m) and m.x > high.x + 0.3, each=lambda: client.send(*north)
        )
        assert client.log[-1].vx > 0.1 or client.until(is_a("LOCAL_POSITION_NED")).vx > 0.1
        client.send(client.command(21))
        client.until(is_a("HEARTBEAT", custom_mode=LAND))
        client.until(is_a("EXTENDED_SYS_STATE", landed_state=mav.MAV_LANDED_STATE_ON_GROUND))
        client.until(lambda m: is_a("HEARTBEAT")(m) and not m.base_mode & ARMED)

        client.log.clear()
        start_s = time.monotonic()
        while time.monotonic() < start_s + 1.0:
            client.receive(0.1)
        times_ms = [m.time_boot_ms for m in client.log if m.get_type() == "LOCAL_POSITION_NED"]
        assert 60 <= len(times_ms) <= 110  # a busy machine may lose some tenths
        assert {b - a for a, b in itertools.pairwise(times_ms)} == {10}
        assert terminate(child) < 1.0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("lockstep", [False, True])
def test_ends_on_a_signal_also_before_anybody_has_called(lockstep: bool, number: signal.Signals) -> None:
    with vehicle(1, lockstep=lockstep) as (child, ready):
        assert ready.startswith("ready udpin:127.0.0.1:")
        assert terminate(child, number) < 1.0


def test_after_a_pause_it_goes_on_from_there_and_takes_no_core_from_others() -> None:
    with vehicle(1, lockstep=False) as (child, ready):
        client = Client(ready.removeprefix("ready "))
        called_s = time.monotonic()
        client.hello()
        before = client.until(is_a("LOCAL_POSITION_NED")).time_boot_ms
        child.send_signal(signal.SIGSTOP)
        start_s = time.monotonic()
        wait_for(lambda: time.monotonic() - start_s > 0.5, "half a second")
        child.send_signal(signal.SIGCONT)
        client.until(lambda m: is_a("STATUSTEXT")(m) and re.match(r"Machine paused \d\.\d\d s", m.text))
        after = client.until(is_a("LOCAL_POSITION_NED")).time_boot_ms
        assert 0 < after - before < 1000.0 * (time.monotonic() - called_s) - 400.0  # it stood still
        assert os.sched_getscheduler(child.pid) == os.SCHED_OTHER
        assert terminate(child) < 1.0


@pytest.mark.parametrize("lockstep", [False, True])
def test_the_robots_poses_wait_for_no_other_program_but_in_lockstep(lockstep: bool) -> None:
    if not ask_for_priority():
        pytest.skip("this system gives no priority: its tests run without it")
    give_up_priority()
    with process("target", seed=1, lockstep=lockstep, rate_hz=RATE_HZ) as (child, ready):
        assert ready == "ready"

        def prompt() -> set[int]:
            threads = [int(each.name) for each in Path(f"/proc/{child.pid}/task").iterdir()]
            return {each for each in threads if os.sched_getscheduler(each) == os.SCHED_FIFO}

        if lockstep:
            assert not prompt()
        else:  # its own thread asks after it has said that it is ready
            wait_for(lambda: child.pid in prompt() and len(prompt()) > 1, "priority of the target")
        terminate(child)


def test_bad_url_is_an_error_with_a_reason() -> None:
    with vehicle(1, lockstep=False, url="tcp:127.0.0.1:1") as (child, _):
        _, err = child.communicate(timeout=10.0)
        assert child.returncode == 2
        assert "udpin:HOST:PORT" in err


class Companion(Client):
    """Answers TIMESYNC; its plan is a function of the tick."""

    def __init__(self, url: str, *, listen: bool = False) -> None:
        super().__init__(url, listen=listen)
        self.tick = -1
        self.last_request = b""
        if not listen:
            self.hello()

    def step(self, timeout_s: float = 20.0) -> bool:
        """Wait for the next tick's request and answer it; False if it did not come."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            for message in self.receive(max(0.0, deadline_s - time.monotonic())):
                if message.get_type() != "TIMESYNC" or message.tc1 != 0:
                    continue
                raw = bytes(message.get_msgbuf())
                answer = mav.MAVLink_timesync_message(message.ts1 + 1, message.ts1)
                if raw == self.last_request:  # a repetition after a pause of the machine
                    self.frames.remove(raw)
                    self.send(answer)
                    continue
                self.last_request = raw
                self.tick += 1
                assert message.ts1 == self.tick * 1_000_000_000 // RATE_HZ
                self.send(*self.plan(self.tick), answer)
                return True
        return False

    def plan(self, tick: int) -> list:
        commands = {5: self.command(400, 1.0), 8: self.command(22), 350: self.command(176, 1.0, 6.0)}
        first = [commands[tick]] if tick in commands else []
        return [setpoint(0.2, -0.1, 0.0), *first] if tick >= 340 else first


def fly(seed: int, ticks: int) -> list[bytes]:
    with vehicle(seed, lockstep=True) as (child, ready):
        companion = Companion(ready.removeprefix("ready "))
        for _ in range(ticks):
            assert companion.step()
        beats = [m for m in companion.log if m.get_type() == "HEARTBEAT"]
        assert beats[-1].custom_mode == OFFBOARD
        assert terminate(child) < 1.0
        return companion.frames


def test_lockstep_gives_the_same_bytes_for_the_same_seed() -> None:
    first = fly(7, 460)
    assert len(first) > 3 * 460
    assert fly(7, 460) == first
    assert fly(8, 460) != first


def test_companion_that_falls_silent_lets_the_vehicle_land_in_simulated_time_and_may_come_back() -> None:
    with vehicle(3, lockstep=True) as (child, ready):
        companion = Companion(ready.removeprefix("ready "))
        for _ in range(500):
            assert companion.step()
        lost_s = 5.0
        companion.log.clear()
        silent_s = time.monotonic()
        companion.until(is_a("STATUSTEXT", text="Companion silent for 10 s: going on without"))
        assert time.monotonic() - silent_s > 9.0
        companion.until(lambda m: is_a("HEARTBEAT")(m) and m.custom_mode == LAND)
        companion.until(lambda m: is_a("HEARTBEAT")(m) and not m.base_mode & ARMED)
        texts = [m.text for m in companion.log if m.get_type() == "STATUSTEXT"]
        assert "No set-points for 0.5 s: landing" in texts
        assert "Landed, disarmed" in texts
        positions = [m for m in companion.log if m.get_type() == "LOCAL_POSITION_NED"]
        assert -positions[-1].z < 0.03
        landing = next(m.time_boot_ms for m in positions if m.vz > 0.1)
        assert 0.5 <= landing / 1000 - lost_s <= 1.0
        assert positions[-1].time_boot_ms / 1000 - lost_s < 8.0

        def answer() -> None:
            for message in reversed(companion.log):
                if message.get_type() == "TIMESYNC":
                    companion.send(mav.MAVLink_timesync_message(message.ts1 + 1, message.ts1))
                    break

        companion.until(is_a("STATUSTEXT", text="Companion answers again"), each=answer)
        assert terminate(child) < 1.0


def test_vehicle_that_calls_loses_nothing_of_the_first_tick() -> None:
    port = free_port()
    companion = Companion(f"udpin:127.0.0.1:{port}", listen=True)
    with vehicle(1, lockstep=True, url=f"udpout:127.0.0.1:{port}", duration_s=0.2) as (child, ready):
        assert ready == f"ready udpout:127.0.0.1:{port}"
        for _ in range(20):
            assert companion.step()
        assert child.wait(5.0) == 0
    times_ms = [m.time_boot_ms for m in companion.log if m.get_type() == "LOCAL_POSITION_NED"]
    assert times_ms == list(range(0, 200, 10))


def test_robot_that_falls_silent_stops_the_deck_but_not_the_flight() -> None:
    port = free_port()
    session = zenoh_link.open_session([f"tcp/127.0.0.1:{port}"], [])
    robot = OdometryPublisher(session, "cf1/sim/target/truth", lossless=True)
    try:
        with vehicle(2, lockstep=True, connect=[f"tcp/127.0.0.1:{port}"]) as (child, ready):
            wait_for(lambda: robot.matched, "the vehicle's subscription")
            for tick in range(50):
                pose = robot.encode(
                    tick, (0.001 * tick, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0), (0.1, 0.0, 0.0), ZERO
                )
                robot.put(pose, tick, struct.pack("<qq", tick, 0))
            companion = Companion(ready.removeprefix("ready "))
            for _ in range(200):
                assert companion.step()
            texts = [m.text for m in companion.log if m.get_type() == "STATUSTEXT"]
            assert texts[-2:] == [
                "Robot silent for 5 s: going on without",
                "Robot's pose too old: deck stopped",
            ]
            assert terminate(child) < 1.0
    finally:
        session.close()


PAIR = struct.Struct("<qq")
RUN_AHEAD = 20
GO_TICK = 60


def target(seed: int, port: int, *, lockstep: bool, **more):
    listen = [f"tcp/127.0.0.1:{port}"]
    return process("target", seed=seed, lockstep=lockstep, listen=listen, namespace="t", **more)


class Reader:
    """Stands for the vehicle and the onboard process: reads everything, gives credit."""

    def __init__(self, port: int) -> None:
        self.session = zenoh_link.open_session([], [f"tcp/127.0.0.1:{port}"])
        self.truth = zenoh_link.fifo_subscriber(self.session, "t/sim/target/truth")
        self.odom = zenoh_link.fifo_subscriber(self.session, "t/target/odom")
        self.marker = zenoh_link.fifo_subscriber(self.session, "t/sim/target/tick")
        self._credit = zenoh_link.blocking_publisher(self.session, "t/sim/credit")
        self.truths: list[tuple[int, bytes]] = []
        self.samples: list[bytes] = []
        self.sequence: list[int] = []
        self.markers: list[tuple[int, int]] = []

    def credit(self, tick: int, go_tick: int = -1) -> None:
        self._credit.put(PAIR.pack(tick, go_tick))

    def poll(self) -> None:
        for sample in zenoh_link.drain(self.truth):
            self.truths.append((PAIR.unpack(sample.attachment.to_bytes())[0], sample.payload.to_bytes()))
        for sample in zenoh_link.drain(self.odom):
            self.samples.append(sample.payload.to_bytes())
            self.sequence.append(struct.unpack_from("<q", sample.attachment.to_bytes())[0])
        self.markers += [PAIR.unpack(s.payload.to_bytes()) for s in zenoh_link.drain(self.marker)]

    def reached(self, tick: int) -> bool:
        self.poll()
        whole = bool(self.markers) and self.markers[-1][0] >= tick
        return whole and len(self.truths) > tick and len(self.samples) >= self.markers[-1][1]


def drive(seed: int, ticks: int) -> Reader:
    port = free_port()
    with target(seed, port, lockstep=True) as (child, ready):
        assert ready == "ready"
        reader = Reader(port)
        try:
            wait_for(lambda: reader.reached(RUN_AHEAD), "the run-ahead")
            for tick in range(0, ticks, 5):
                reader.credit(tick, GO_TICK)
                wait_for(lambda tick=tick: reader.reached(tick + RUN_AHEAD), f"tick {tick}")  # type: ignore[misc]
                assert reader.markers[-1][0] <= tick + RUN_AHEAD
            assert terminate(child) < 1.0
        finally:
            reader.session.close()
    return reader


def test_lockstep_is_whole_and_the_same_for_the_same_seed() -> None:
    one, two = drive(5, 200), drive(5, 200)
    ticks = [tick for tick, _ in one.truths]
    assert ticks == list(range(len(ticks)))
    assert [tick for tick, _ in one.markers] == ticks
    assert one.markers[-1][1] == len(one.samples)
    assert one.sequence == list(range(1, len(one.samples) + 1))
    assert (one.truths, one.samples, one.markers) == (two.truths, two.samples, two.markers)
    assert drive(6, 50).samples != one.samples[: len(one.samples)]


def test_robot_stands_until_the_go_tick_and_the_truth_is_consistent() -> None:
    reader = drive(5, 200)
    poses = [decode_odometry(payload) for _, payload in reader.truths]
    assert all(p.linear_m_s == (0.0, 0.0, 0.0) for p in poses[:GO_TICK])
    assert poses[GO_TICK].linear_m_s[0] > 0.0
    assert poses[-1].linear_m_s[0] == pytest.approx(0.1, abs=0.005)
    moved = math.dist(poses[-1].position_m, poses[GO_TICK].position_m)
    assert 0.08 < moved < 0.16
    assert {(p.frame_id, p.child_frame_id) for p in poses} == {("map", "target")}
    assert {b.stamp_ns - a.stamp_ns for a, b in itertools.pairwise(poses)} == {10_000_000}
    late = [decode_odometry(payload) for payload in reader.samples]
    assert late[0].stamp_ns == poses[0].stamp_ns
    assert reader.markers[0][1] == 0  # the scenario's tracker is 10 ms late
    assert reader.markers[1][1] == 1


def test_go_tick_that_comes_too_late_is_reported() -> None:
    port = free_port()
    with target(5, port, lockstep=True) as (child, _):
        reader = Reader(port)
        try:
            wait_for(lambda: reader.reached(RUN_AHEAD), "the run-ahead")
            reader.credit(10, go_tick=3)
            wait_for(lambda: reader.reached(30), "the credit")
            assert terminate(child) < 1.0
            assert child.stderr is not None
            assert "go-tick 3 came when the robot was at" in child.stderr.read()
        finally:
            reader.session.close()


@pytest.mark.xdist_group("real-time")
def test_real_time_rate_and_start_with_the_landing() -> None:
    port = free_port()
    with target(5, port, lockstep=False) as (child, ready):
        assert ready == "ready"
        reader = Reader(port)
        steps = zenoh_link.blocking_publisher(reader.session, "t/controller/step")
        try:
            wait_for(lambda: reader.poll() or len(reader.truths) > 5, "the stream")
            wait_for(lambda: zenoh_link.is_matched(steps), "the reader of controller steps")
            reader.truths.clear()
            reader.samples.clear()
            start_s = time.monotonic()
            wait_for(lambda: reader.poll() or time.monotonic() > start_s + 1.0, "a second")
            assert 60 <= len(reader.truths) <= 110  # a busy machine may lose some tenths
            assert 60 <= len(reader.samples) <= 110
            steps.put(controller_step(Phase.TAKEOFF))
            steps.put(b"rubbish")
            last = decode_odometry(reader.truths[-1][1])
            assert abs(last.stamp_ns - time.time_ns()) < 0.2e9
            assert last.linear_m_s[0] == 0.0
            steps.put(controller_step(Phase.APPROACH))
            wait_for(
                lambda: reader.poll() or decode_odometry(reader.truths[-1][1]).linear_m_s[0] > 0.05, "a move"
            )
            assert terminate(child) < 1.0
        finally:
            reader.session.close()


@pytest.mark.parametrize("lockstep", [False, True])
def test_ends_on_a_signal_while_it_waits(lockstep: bool) -> None:
    with target(1, free_port(), lockstep=lockstep) as (child, ready):
        assert ready == "ready"
        assert terminate(child) < 1.0


def test_port_that_is_taken_is_an_error_with_a_reason() -> None:
    port = free_port()
    with target(1, port, lockstep=False) as (_, ready), target(1, port, lockstep=False) as (second, _):
        assert ready == "ready"
        _, err = second.communicate(timeout=PATIENCE_S)
        assert second.returncode == 1
        assert f"tcp/127.0.0.1:{port}" in err


def controller_step(phase: Phase) -> bytes:
    return ControllerStepRow(
        0, 0, int(phase), 0, 0, 0, True, False, True, True, 0.0, 0.0, ZERO, ZERO, 0.0, ZERO, ZERO, 0.0,
        0.0, ZERO, 0.0, ZERO, ZERO, ZERO, 0.0, 0.0, 0, 0, 0, True, False, ZERO, 0.0,
    ).pack()  # fmt: skip
