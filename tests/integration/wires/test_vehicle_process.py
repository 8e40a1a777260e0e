"""Tests the vehicle process over its real connections: in real time with a plain client, and in lockstep."""

from __future__ import annotations

import itertools
import os
import re
import signal
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.ros2.cdr import decode_odometry
from bridge.zenoh import zenoh_link
from flightstack.core.types import Phase
from tests.integration.runs import flightstack
from tests.integration.sim_processes import (
    Client,
    is_a,
    priority_or_skip,
    process,
    prompt_threads,
    setpoint,
    terminate,
)
from tests.processes.bounded import AT_ONCE_S, wait_for
from tests.processes.ports import free_port
from tests.step_rows import step_row

ARMED = 128
LAND = 0x06040000
RATE_HZ = 100


def vehicle(seed: int, *, lockstep: bool, url: str = "udpin:127.0.0.1:0", **more):
    return process("vehicle", seed=seed, url=url, lockstep=lockstep, **more)


def test_its_time_is_that_of_the_wall() -> None:
    with vehicle(1, lockstep=False) as (child, ready):
        client = Client(ready.removeprefix("ready "))
        client.hello()
        client.until(is_a("LOCAL_POSITION_NED"))
        client.log.clear()
        start_s, times_ms = time.monotonic(), []
        while len(times_ms) < 101:
            assert client.receive(), "no telemetry"
            times_ms = [m.time_boot_ms for m in client.log if m.get_type() == "LOCAL_POSITION_NED"]
        assert time.monotonic() - start_s > 0.8  # 101 messages take 1 s; delayed messages arrive together
        assert {b - a for a, b in itertools.pairwise(times_ms)} == {10}
        terminate(child)


@pytest.mark.parametrize(("lockstep", "number"), [(False, signal.SIGINT), (True, signal.SIGTERM)])
def test_ends_on_a_signal_also_before_anybody_has_called(lockstep: bool, number: signal.Signals) -> None:
    with vehicle(1, lockstep=lockstep) as (child, ready):
        assert ready.startswith("ready udpin:127.0.0.1:")
        terminate(child, number)


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
        assert 0 < after - before < 1000.0 * (time.monotonic() - called_s) - 400.0  # the clock has stopped
        assert os.sched_getscheduler(child.pid) == os.SCHED_OTHER
        terminate(child)


class Companion(Client):
    """Answers TIMESYNC; its set-points are a function of the tick."""

    def __init__(self, url: str, *, listen: bool = False) -> None:
        super().__init__(url, listen=listen)
        self.tick = -1
        self.last_request = b""
        if not listen:
            self.hello()

    def step(self, timeout_s: float = 20.0) -> bool:
        """Wait for the next tick's request and answer it; return False after a time-out."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            for message in self.receive(max(0.0, deadline_s - time.monotonic())):
                if message.get_type() != "TIMESYNC" or message.tc1 != 0:
                    continue
                raw = bytes(message.get_msgbuf())
                answer = mav.MAVLink_timesync_message(message.ts1 + 1, message.ts1)
                if raw == self.last_request:  # repeated after a pause of the machine
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


def test_an_answer_from_before_the_end_is_acted_on_however_late_the_vehicle_gets_to_run() -> None:
    class Leaves(Companion):
        def plan(self, tick: int) -> list:
            if tick == 20:
                for number in (signal.SIGSTOP, signal.SIGTERM):
                    os.kill(child.pid, number)
            return []

    with vehicle(1, lockstep=True) as (child, ready):
        companion = Leaves(ready.removeprefix("ready "))
        for _ in range(21):
            assert companion.step()
        os.kill(child.pid, signal.SIGCONT)
        assert companion.step()  # otherwise logs of equal flights would differ by one true state
        assert child.wait(AT_ONCE_S) == 0


def test_companion_that_falls_silent_lets_the_vehicle_land_in_simulated_time_and_may_come_back() -> None:
    with vehicle(3, lockstep=True) as (child, ready):
        companion = Companion(ready.removeprefix("ready "))
        for _ in range(500):
            assert companion.step()
        lost_s = 5.0
        companion.log.clear()
        silent_s = time.monotonic()
        companion.until(is_a("STATUSTEXT", text="Companion silent for 20 s: going on without"))
        assert time.monotonic() - silent_s > 19.0
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
        terminate(child)


def test_vehicle_that_calls_loses_nothing_of_the_first_tick() -> None:
    port = free_port(udp=True)
    companion = Companion(f"udpin:127.0.0.1:{port}", listen=True)
    with vehicle(1, lockstep=True, url=f"udpout:127.0.0.1:{port}", duration_s=0.2) as (child, ready):
        assert ready == f"ready udpout:127.0.0.1:{port}"
        for _ in range(20):
            assert companion.step()
        assert child.wait(AT_ONCE_S) == 0
    times_ms = [m.time_boot_ms for m in companion.log if m.get_type() == "LOCAL_POSITION_NED"]
    assert times_ms == list(range(0, 200, 10))


def target(seed: int, port: int, **more):
    return process("target", seed=seed, listen=[f"tcp/127.0.0.1:{port}"], namespace="t", **more)


class Reader:
    def __init__(self, port: int) -> None:
        self.session = zenoh_link.open_session([], [f"tcp/127.0.0.1:{port}"])
        self._truth = zenoh_link.fifo_subscriber(self.session, "t/sim/target/truth")
        self._odom = zenoh_link.fifo_subscriber(self.session, "t/target/odom")
        self.truths: list[bytes] = []
        self.samples: list[bytes] = []

    def poll(self) -> None:
        self.truths += [sample.payload.to_bytes() for sample in zenoh_link.drain(self._truth)]
        self.samples += [sample.payload.to_bytes() for sample in zenoh_link.drain(self._odom)]


@pytest.mark.xdist_group("real-time")
def test_real_time_rate_and_start_with_the_landing() -> None:
    port = free_port()
    with target(5, port) as (child, ready):
        assert ready == "ready"
        reader = Reader(port)
        steps = zenoh_link.blocking_publisher(reader.session, "t/controller/step")
        try:
            wait_for(lambda: reader.poll() or len(reader.truths) > 5, "the stream")
            wait_for(lambda: zenoh_link.is_matched(steps), "the reader of controller steps")
            reader.truths.clear()
            reader.samples.clear()
            start_s = time.monotonic()
            wait_for(lambda: reader.poll() or len(reader.truths) > 100, "a hundred poses")
            wait_for(lambda: reader.poll() or len(reader.samples) > 100, "a hundred samples")
            assert time.monotonic() - start_s > 0.5  # delayed messages arrive together
            steps.put(controller_step(Phase.TAKEOFF))
            steps.put(b"rubbish")
            last = decode_odometry(reader.truths[-1])
            assert abs(last.stamp_ns - time.time_ns()) < 1e9 * AT_ONCE_S
            assert last.linear_m_s[0] == 0.0
            steps.put(controller_step(Phase.APPROACH))
            wait_for(
                lambda: reader.poll() or decode_odometry(reader.truths[-1]).linear_m_s[0] > 0.05, "a move"
            )
            terminate(child)
        finally:
            reader.session.close()


@pytest.mark.parametrize("lockstep", [False, True])
def test_the_robots_poses_wait_for_no_other_program_but_in_lockstep(lockstep: bool) -> None:
    priority_or_skip()
    where = [f"tcp/127.0.0.1:{free_port()}"]
    with process("world", listen=where, url="udpin:127.0.0.1:0", lockstep=lockstep) as (child, ready):
        assert ready.startswith("ready udpin:")
        if lockstep:
            assert not prompt_threads(child.pid)
        else:  # requested after the process has printed ready
            wait_for(lambda: len(prompt_threads(child.pid) - {child.pid}) > 0, "priority of its threads")
            wait_for(lambda: child.pid in prompt_threads(child.pid), "priority of the world")
        terminate(child)


def controller_step(phase: Phase) -> bytes:
    return step_row(phase=int(phase)).pack()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--scenario", "fleet_3"), "robots and messages between vehicles are on Zenoh: give --connect"),
        (
            ("--scenario", "fleet_3", "--member", "1"),
            "found members 2, 3, which this command does not simulate",
        ),
    ],
)
def test_a_fleet_in_lockstep_that_could_not_talk_is_refused(words: tuple[str, ...], why: str) -> None:
    done = flightstack("vehicle", *words, "--lockstep")
    assert (done.code, why in done.err) == (2, True)
