"""Makes the log rows of a synthetic landing: a point mass with lag, a turning pad, the exact projection.

Tests change the rows and write them as a real log. This module does not judge the flight.
"""

import functools
import math
import random
from dataclasses import dataclass, field
from pathlib import Path

from bridge.ros2.cdr import Odometry
from flightstack.common.pacing import EPOCH_NS
from flightstack.core.safety.barrier import Barrier
from flightstack.core.safety.position_loop import nominal_velocity, slew
from flightstack.core.safety.projection import projected
from flightstack.core.types import Phase
from logs.recorder.recording import McapFile
from logs.schema import schemas
from logs.schema.events import pack_log
from logs.schema.rows import ControllerStepRow, LoopTimingRow, TrueStateRow
from tests.step_rows import step_row

DT_S = 0.01
RATE_HZ = 100
BOX = (0.2, 0.2, 0.5)
OMEGA_1_S = 0.7
LAG_S = 0.25
PAD_Z_M = 0.2
FEET_M = 0.0144
GROUND_S = 1.0  # time on the ground before the take-off, s
START_E_M = (1.4, -0.8, 0.6)
BARRIER = Barrier(1.0, 1.5)
NAN3 = (math.nan,) * 3
MAX_S = 60.0
AFTER_S = 3.0
PAD, GROUND, ROBOT, EDGE, TUMBLED = 1, 2, 4, 8, 16


@dataclass
class Rows:
    """Rows of a log; a test may change the lists."""

    steps: list[ControllerStepRow]
    truth: list[TrueStateRow]
    timing: list[LoopTimingRow]
    odometry: list[tuple[int, bytes]]
    events: list[tuple[int, int, str]]
    run: dict = field(
        default_factory=lambda: {
            "scenario": "synthetic", "seed": "7", "filter": "paper", "mode": "lockstep",
            "rate_hz": str(RATE_HZ), "judge_alpha_1_m": "1.0", "judge_beta_m": "1.5",
            "pad_radius_m": "0.1",
        }
    )  # fmt: skip
    losses: dict = field(default_factory=dict)

    def copy(self):
        return Rows(
            list(self.steps), list(self.truth), list(self.timing), list(self.odometry), list(self.events),
            dict(self.run), dict(self.losses),
        )  # fmt: skip

    def cut(self, after_s):
        """Remove all rows that are more than ``after_s`` later than the start of the log."""
        limit = EPOCH_NS + round(after_s * 1e9)
        self.steps = [r for r in self.steps if r.stamp_ns <= limit]
        self.truth = [r for r in self.truth if r.stamp_ns <= limit]
        self.timing = [r for r in self.timing if r.stamp_ns <= limit]

    def change_truth(self, when, **values):
        self.truth = [r._replace(**values) if when(r) else r for r in self.truth]

    @property
    def touch(self):
        """Return the index of the first true state with contact to the pad."""
        return next(i for i, r in enumerate(self.truth) if r.contacts & PAD and r.tick > self.begin_tick)

    @property
    def begin_tick(self):
        return next(r.tick for r in self.steps if r.phase == Phase.APPROACH)


@functools.cache
def _landing() -> Rows:
    rng = random.Random(7)
    rows = Rows([], [], [], [], [])
    pad, heading = (0.0, 0.0, PAD_Z_M), 0.3
    p, v, command, phase = (-0.5, -0.6, FEET_M), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), Phase.WAIT
    touch = (NAN3, NAN3, math.nan)
    stand = None  # offset of the resting vehicle from the pad's centre
    off_s = math.inf
    tick = 0
    while tick * DT_S < min(MAX_S, off_s + AFTER_S):
        t_s, stamp = tick * DT_S, EPOCH_NS + tick * 10_000_000
        go = phase >= Phase.APPROACH
        pad_v = (0.1 * math.cos(heading), 0.1 * math.sin(heading), 0.0) if go else (0.0, 0.0, 0.0)
        e = tuple(a - b for a, b in zip(p, pad, strict=True))
        d = math.hypot(e[0], e[1])
        seen_p = tuple(a + rng.gauss(0.0, 0.001) for a in p)
        seen_e = tuple(a - b for a, b in zip(seen_p, pad, strict=True))
        h, gradient, dh_dt = BARRIER.evaluate(seen_e, pad_v)
        nominal = nominal_velocity(seen_e, (1.0, 1.0, 1.0), pad_v)
        bound = -OMEGA_1_S * h - dh_dt
        filtered, _ = projected(nominal, gradient, bound, tuple(-b for b in BOX), BOX)
        aim = tuple(b + o for b, o in zip(pad, START_E_M, strict=True))
        before = phase
        if phase == Phase.WAIT and t_s >= GROUND_S:
            phase = Phase.TAKEOFF
        elif phase == Phase.TAKEOFF and math.dist(p, aim) < 0.03:
            phase = Phase.APPROACH
        elif phase == Phase.APPROACH and d < 0.1 and e[2] < 0.3:
            phase = Phase.LAND
        elif phase == Phase.LAND and e[2] < 0.05 and d < 0.08:
            phase, off_s = Phase.TOUCHDOWN, t_s
        elif phase == Phase.TOUCHDOWN and t_s > off_s + 0.1:
            phase = Phase.LANDED
        if phase is not before:
            rows.events.append((stamp, 20, f"{before.name} -> {phase.name}: made up"))
        flying = phase in (Phase.TAKEOFF, Phase.APPROACH, Phase.LAND)
        wanted = (0.0, 0.0, 0.0)
        if phase == Phase.TAKEOFF:
            wanted = tuple(max(-1.0, min(1.0, 1.5 * (a - b))) for a, b in zip(aim, p, strict=True))
        elif flying:
            wanted = filtered
        command = slew(command, wanted, (0.04, 0.04, 0.04))
        rows.steps.append(
            step_row(
                stamp_ns=stamp, tick=tick, phase=phase, request=2 if flying else 0,
                filter_status=1 if go else 0, gate=0 if flying else 1, setpoint_sent=flying,
                barrier_active=go and filtered != nominal, own_valid=True, target_valid=True,
                own_age_s=0.005, target_age_s=0.01 + 0.01 * rng.random(),
                own_position_enu_m=seen_p, own_velocity_enu_m_s=v,
                target_position_enu_m=pad, target_velocity_enu_m_s=pad_v, target_yaw_rad=heading,
                h_m=h, gradient=gradient, dh_dt_m_s=dh_dt, nominal_enu_m_s=nominal,
                filtered_enu_m_s=filtered if go else NAN3, command_enu_m_s=command,
                slack_m_s=sum(g * u for g, u in zip(gradient, command, strict=True)) - bound,
                residual=1e-10, iterations=40, target_accepted=tick, wanted_enu_m_s=NAN3,
                command_yaw_rad=math.nan,
            )
        )  # fmt: skip
        truth_h = BARRIER.h(e)
        on_ground = p[2] <= FEET_M + 1e-9
        rows.truth.append(
            TrueStateRow(
                stamp, tick, p, v, (0.0, 0.0, 0.0, 1.0), (0.0,) * 3, (20000.0,) * 4, pad, pad_v, heading,
                truth_h, truth_h - 1e-5, truth_h - 1e-5 if d > 0.1 else math.inf,
                PAD if stand else 2 if on_ground else 0, *touch, t_s < off_s and t_s > GROUND_S, 3.9,
                (0.0, 0.0, 0.0),
            )
        )  # fmt: skip
        late = abs(rng.gauss(0.0, 5e-5))
        rows.timing.append(
            LoopTimingRow(stamp, tick, DT_S + rng.gauss(0.0, 5e-5), late, 2e-4 + late, 4e-5 + late, 0, 0)
        )
        yaw = (math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2))
        rows.odometry.append(
            (stamp, Odometry(stamp, "map", "target", pad, yaw, (math.hypot(*pad_v[:2]), 0.0, 0.0)).pack())
        )
        if flying:
            v = tuple(a + (c - a) * DT_S / LAG_S for a, c in zip(v, command, strict=True))
        elif stand is None and go:
            v = (v[0], v[1], v[2] - 9.81 * DT_S)
        pad = tuple(a + b * DT_S for a, b in zip(pad, pad_v, strict=True))
        heading += 0.1 * DT_S if go else 0.0
        p = tuple(a + b * DT_S for a, b in zip(p, v, strict=True))
        e = tuple(a - b for a, b in zip(p, pad, strict=True))
        if stand is None and go and e[2] <= FEET_M and math.hypot(e[0], e[1]) < 0.1:
            relative = tuple(a - b for a, b in zip(v, pad_v, strict=True))
            touch, stand = ((e[0], e[1], FEET_M), relative, (tick + 0.5) * DT_S), e[:2]
        if stand is not None:
            p = (pad[0] + stand[0], pad[1] + stand[1], pad[2] + FEET_M)
            v = pad_v
        tick += 1
    return rows


def landing() -> Rows:
    """Return a landing without faults, for tests to change."""
    return _landing().copy()


def write_log(path: Path, rows: Rows, *, complete: bool = True, namespace: str = "cf1") -> Path:
    """Write the rows as a real log; ``complete=False`` truncates the log, like a killed recorder."""
    log = McapFile(path)
    log.metadata("run", rows.run)
    log.metadata("made", {"version": "0.1.0", "python": "3.11"})
    steps = log.channel(f"/{namespace}/controller/step", schemas.CONTROLLER_STEP)
    timing = log.channel(f"/{namespace}/loop/timing", schemas.LOOP_TIMING)
    truth = log.channel(f"/{namespace}/sim/truth", schemas.TRUE_STATE)
    odometry = log.channel(f"/{namespace}/target/odom", schemas.ODOMETRY)
    rosout = log.channel("/rosout", schemas.LOG)
    messages = (
        [(r.stamp_ns, steps, r.tick, r.pack()) for r in rows.steps]
        + [(r.stamp_ns, truth, r.tick, r.pack()) for r in rows.truth]
        + [(r.stamp_ns, timing, r.tick, r.pack()) for r in rows.timing]
        + [(at, odometry, n, payload) for n, (at, payload) in enumerate(rows.odometry)]
        + [(at, rosout, 0, pack_log(at, level, "onboard", text)) for at, level, text in rows.events]
    )
    for at, channel, number, payload in sorted(messages, key=lambda m: m[0]):
        log.write(channel, at, at, number, payload)
    if rows.losses:
        log.metadata("losses", rows.losses)
    log.close()
    if not complete:
        data = path.read_bytes()
        path.write_bytes(data[: int(len(data) * 0.9)])
    return path
