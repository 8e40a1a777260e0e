"""The process of the target on its real wires, and how it ends; priority of the world's threads."""

from __future__ import annotations

import time

import pytest

from bridge.ros2.cdr import decode_odometry
from bridge.zenoh import zenoh_link
from flightstack.core.types import ZERO, Phase
from logs.schema.rows import ControllerStepRow
from tests.integration.sim_processes import (
    priority_or_skip,
    process,
    prompt_threads,
    terminate,
    wait_for,
)
from tests.processes.bounded import AT_ONCE_S
from tests.processes.ports import free_port


def target(seed: int, port: int, **more):
    return process("target", seed=seed, listen=[f"tcp/127.0.0.1:{port}"], namespace="t", **more)


class Reader:
    """Stands for the vehicle and the onboard process: reads everything."""

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
            assert time.monotonic() - start_s > 0.5  # s; what a busy machine held up comes at once
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
        else:  # its own thread asks after it has said that it is ready
            wait_for(lambda: len(prompt_threads(child.pid) - {child.pid}) > 0, "priority of its threads")
            wait_for(lambda: child.pid in prompt_threads(child.pid), "priority of the world")
        terminate(child)


def controller_step(phase: Phase) -> bytes:
    return ControllerStepRow(
        0, 0, int(phase), 0, 0, 0, True, False, True, True, 0.0, 0.0, ZERO, ZERO, 0.0, ZERO, ZERO, 0.0,
        0.0, ZERO, 0.0, ZERO, ZERO, ZERO, 0.0, 0.0, 0, 0, 0, True, False, ZERO, 0.0,
    ).pack()  # fmt: skip
