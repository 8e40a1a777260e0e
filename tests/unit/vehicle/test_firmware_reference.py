"""Compares the firmware model with outputs of the Crazyflie firmware's compiled C code on random states.

``tests/data/README.md`` lists the functions and their commit, and how the numbers were made. The model
computes in double precision, the firmware in single; so integer counts may differ by one where a value is
close to an integer.
"""

from pathlib import Path

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.firmware.geometric import K_V_N_S_M, PaperRecord, paper_update, set_up_paper
from sim.firmware.mixer import COUNTS_MAX, cap, spread
from sim.firmware.pid import CascadeRecord, cascade_update, set_up_cascade
from sim.firmware.setpoint import SensedState, SetpointRecord, set_point
from sim.firmware.supervisor import (
    PERIOD_MS,
    STATES,
    State,
    SupervisorRecord,
    arm,
    disarm,
    restart,
    supervise,
)  # fmt: skip
from sim.plant.params import load
from sim.plant.states import rotation_axes

pytestmark = pytest.mark.slow
DATA = Path(__file__).parents[2] / "data"
PARAMS = load()
MASS_THRUST = 132000.0  # counts per N, controller_mellinger.c
ONE_COUNT = 1.01

MAPPED = {
    "NotInitialized": State.DISARMED,
    "PreFlChecksNotPassed": State.DISARMED,
    "PreFlChecksPassed": State.DISARMED,
    "Reset": State.DISARMED,
    "ReadyToFly": State.READY,
    "Flying": State.FLYING,
    "WarningLevelOut": State.LEVEL_OUT,
    "Landed": State.LANDED,
    "ExceptFreeFall": State.LOCKED,
    "Locked": State.LOCKED,
    "Crashed": State.CRASHED,
}


def data(name):
    return np.load(DATA / f"firmware_{name}.npz")


def euler_axes(roll, pitch, yaw):
    """Return the body axes (FLU) after a ZYX rotation by these angles, rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    x = (cy * cp, sy * cp, -sp)
    y = (cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr)
    z = (cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr)
    return (*x, *y, *z)


def sensed(axes, gyro_deg_s, velocity=(0.0, 0.0, 0.0)):
    record = new(SensedState)
    record.axes, record.velocity = axes, velocity
    record.rates = np.radians(np.asarray(gyro_deg_s, float))
    return record


def setpoint(velocity, yaw_deg):
    return new(SetpointRecord, set_point(tuple(map(float, velocity)), float(np.radians(float(yaw_deg)))))


def mellinger_port(rows):
    """Return moments and thrust of the model for a sequence of inputs, in counts of the firmware."""
    r, out = new(PaperRecord), []
    set_up_paper(r, PARAMS)
    for q, gyro, force, yaw in ((row[:4], row[4:7], row[7:10], row[10]) for row in rows.astype(float)):
        wanted = (np.array(force) - (0.0, 0.0, r.weight)) / K_V_N_S_M  # m/s: eq. 8 then gives this force
        state = sensed(rotation_axes(q), gyro)
        thrust, moments = paper_update(r, state, setpoint(wanted, yaw), False)
        out.append((*moments, thrust / r.counts_per_n * MASS_THRUST))
    return np.array(out)


def test_mellinger_attitude_loop():
    d = data("mellinger")
    worst, off = 0.0, 0
    for rows, expected in zip(d["rows"], d["out"].astype(float), strict=True):
        got = mellinger_port(rows)
        difference = np.abs(got[:, :3] - expected[:, :3])
        worst, off = max(worst, difference.max()), off + (difference > 0).sum()
        on = expected[:, 3] > 0.0
        assert got[on, 3] == pytest.approx(expected[on, 3], rel=2e-5, abs=1.0)
        assert not got[~on, 3].any()
    assert worst <= ONE_COUNT
    assert off < 0.01 * d["out"][..., :3].size  # less than 1 % of the moments differ


def pid_port(rows):
    record, out = new(CascadeRecord), []
    set_up_cascade(record, PARAMS)
    for row in rows.astype(float):
        state = sensed(euler_axes(*np.radians(row[:3])), row[3:6], row[6:9])
        level = bool(row[13])
        thrust, moments = cascade_update(record, state, setpoint(row[9:12], row[12]), level)
        out.append((*moments, thrust))
    return np.array(out)


@pytest.mark.parametrize("length", ["short", "long"])
def test_pid_cascade(length):
    d = data("pid")
    off = 0
    for rows, expected in zip(d[f"{length}_rows"], d[f"{length}_out"].astype(float), strict=True):
        difference = np.abs(pid_port(rows) - expected)
        assert difference[:, :3].max() <= ONE_COUNT
        assert difference[:, 3].max() <= ONE_COUNT
        off += (difference[:, :3] > 0).sum()
    assert off < 0.02 * d[f"{length}_out"][..., :3].size


def test_mixer():
    d = data("mixer")
    for thrust, moments, expected in zip(d["thrust"], d["moments"], d["out"], strict=True):
        got = np.array(cap(spread(float(thrust), tuple(int(m) for m in moments)), COUNTS_MAX))
        assert np.abs(got - expected.astype(float)).max() <= ONE_COUNT  # the firmware truncates to integers


def supervisor_port(rows, accelerations):
    port, states = new(SupervisorRecord), []
    restart(port)
    for k, (action, motors, age_ms, accel) in enumerate(rows.tolist()):
        now_ms = 1000 + PERIOD_MS * k
        if action == 1:
            assert arm(port, now_ms) is None
        elif action in (2, 3):  # in the model, recovery from a crash (3) is a disarm (2)
            disarm(port, now_ms)
        supervise(port, now_ms, age_ms, bool(motors), *accelerations[accel].tolist())
        states.append(STATES[port.state])
    return states


def test_supervisor():
    d = data("supervisor")
    names = d["states"].tolist()
    entered = set()
    for i, (rows, expected) in enumerate(zip(d["rows"], d["out"], strict=True)):
        wanted = [MAPPED[names[s]] for s in expected]
        got = supervisor_port(rows, d["accelerations_g"])
        first = next((k for k, (a, b) in enumerate(zip(got, wanted, strict=True)) if a is not b), None)
        assert first is None, f"sequence {i}, update {first}: {got[first]}, firmware {wanted[first]}"
        entered.update(wanted)
    assert entered == set(State)


def test_the_numbers_reach_every_clamp():
    """For each clamp, the reference cases contain values that the clamp limits and values that it passes."""
    mellinger, pid = data("mellinger")["out"], data("pid")["short_out"]
    for moments, clamp in ((mellinger[..., :2], 32000.0), (pid[..., :3], 32767.0)):
        share = (np.abs(moments) >= clamp).mean(axis=(0, 1))
        assert ((share > 0.02) & (share < 0.6)).all()
    assert {20000.0, 65535.0} <= set(np.unique(pid[..., 3]).tolist())
    assert (mellinger[..., 3] <= 0.0).any()
