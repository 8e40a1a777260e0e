"""The process of the target on its real wires: lockstep, real time, and how it ends."""

from __future__ import annotations

import itertools
import math
import struct
import time

import pytest

from bridge.ros2.cdr import decode_odometry
from bridge.zenoh import zenoh_link
from flightstack.core.types import ZERO, Phase
from logs.schema.rows import ControllerStepRow
from tests.integration.sim_processes import (
    PATIENCE_S,
    priority_or_skip,
    process,
    prompt_threads,
    terminate,
    wait_for,
)
from tests.processes.bounded import AT_ONCE_S
from tests.processes.ports import free_port

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
            terminate(child)
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
            terminate(child)
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
            wait_for(lambda: reader.poll() or len(reader.truths) > 100, "a hundred poses")
            wait_for(lambda: reader.poll() or len(reader.samples) > 100, "a hundred samples")
            assert time.monotonic() - start_s > 0.5  # s; what a busy machine held up comes at once
            steps.put(controller_step(Phase.TAKEOFF))
            steps.put(b"rubbish")
            last = decode_odometry(reader.truths[-1][1])
            assert abs(last.stamp_ns - time.time_ns()) < 1e9 * AT_ONCE_S
            assert last.linear_m_s[0] == 0.0
            steps.put(controller_step(Phase.APPROACH))
            wait_for(
                lambda: reader.poll() or decode_odometry(reader.truths[-1][1]).linear_m_s[0] > 0.05, "a move"
            )
            terminate(child)
        finally:
            reader.session.close()


@pytest.mark.parametrize("lockstep", [False, True])
def test_the_robots_poses_wait_for_no_other_program_but_in_lockstep(lockstep: bool) -> None:
    priority_or_skip()
    with target(1, free_port(), lockstep=lockstep) as (child, ready):
        assert ready == "ready"
        if lockstep:
            assert not prompt_threads(child.pid)
        else:  # its own thread asks after it has said that it is ready
            wait_for(lambda: len(prompt_threads(child.pid) - {child.pid}) > 0, "priority of its threads")
            wait_for(lambda: child.pid in prompt_threads(child.pid), "priority of the target")
        terminate(child)


@pytest.mark.parametrize("lockstep", [False, True])
def test_ends_on_a_signal_while_it_waits(lockstep: bool) -> None:
    with target(1, free_port(), lockstep=lockstep) as (child, ready):
        assert ready == "ready"
        terminate(child)


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
