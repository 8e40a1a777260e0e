"""Runs firmware functions on seeded random states and writes inputs and outputs to ``tests/data``.

    python -m tests.reference.generate harness.so

``README.md`` describes the library's build. The tests read the output of this program.
"""

import ctypes
import sys
from pathlib import Path

import numpy as np

DATA = Path(__file__).parents[1] / "data"
SEED = 20261121
PAPER_GAINS = (7e4, 5e3, 2e4, 2e3)  # kR_xy, kR_z, kw_xy, kw_z: K1 and K2 of the paper
WEIGHT_N = 0.0319 * 9.81
STATES = (
    "NotInitialized", "PreFlChecksNotPassed", "PreFlChecksPassed", "ReadyToFly", "Flying", "Landed", "Reset",
    "WarningLevelOut", "ExceptFreeFall", "Locked", "Crashed",
)  # fmt: skip
NOTHING, ARM, DISARM, RECOVER = range(4)


def floats(array):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_float))


def quaternions(euler_deg):
    """Convert roll, pitch and yaw (ZYX), degrees, into quaternions w, x, y, z."""
    half = np.radians(euler_deg) / 2.0
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(half), -1, 0), np.moveaxis(np.sin(half), -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def walk(rng, shape, start, step):
    """Return random walks along axis 1; values are multiples of 1/256, so that the file compresses well."""
    begin = rng.uniform(-1.0, 1.0, (shape[0], 1, shape[2])) * start
    steps = rng.standard_normal(shape) * step
    steps[:, 0] = 0.0
    return np.round((begin + np.cumsum(steps, axis=1)) * 256.0) / 256.0


def mellinger(lib, rng):
    """Return inputs of the attitude loop: slow and fast motion, any attitude, forces in the paper's range."""
    shape = (400, 10, 3)
    wild = np.arange(400)[:, None, None] % 2 == 1
    euler = np.where(
        wild, rng.uniform(-1.0, 1.0, shape) * (180.0, 85.0, 180.0), walk(rng, shape, (30.0, 30.0, 180.0), 1.0)
    )
    gyro = np.where(wild, rng.uniform(-400.0, 400.0, shape), walk(rng, shape, 60.0, 1.0))
    force = walk(rng, shape, (0.15, 0.15, 0.0), 0.005)
    force[..., 2] = rng.uniform(0.25, 1.6, (400, 1)) * WEIGHT_N
    limit = (
        np.tan(np.radians(39.0))
        * force[..., 2]
        / np.maximum(np.hypot(*np.moveaxis(force[..., :2], -1, 0)), 1e-9)
    )
    force[..., :2] *= np.minimum(1.0, limit)[..., None]
    yaw = walk(rng, (400, 10, 1), 180.0, 2.0)
    rows = np.concatenate([quaternions(euler), gyro, force, yaw], axis=-1).astype(np.float32)
    out = np.zeros((400, 10, 4), np.float32)
    gains = np.array(PAPER_GAINS, np.float32)
    for i in range(400):
        lib.harness_mellinger_boot(floats(gains))
        for k in range(10):
            lib.harness_mellinger(floats(rows[i, k]), floats(out[i, k]))
    np.savez_compressed(DATA / "firmware_mellinger.npz", rows=rows, out=out)
    return out


def pid(lib, rng):
    """Return inputs of the PID loops: short ones level out and turn in yaw, long ones saturate integrals."""
    sets = {}
    for name, count, length, tilt, drift in (("short", 240, 15, 8.0, 0.3), ("long", 8, 400, 25.0, 0.02)):
        shape = (count, length, 3)
        euler = walk(rng, shape, (tilt, tilt, 180.0), drift)
        euler[..., :2] = np.clip(euler[..., :2], -80.0, 80.0)
        gyro = walk(rng, shape, 40.0, 1.0)
        velocity, wanted = walk(rng, shape, 1.0, 0.02), walk(rng, shape, 1.0, 0.05)
        off = (
            rng.integers(-20, 21, (count, 1, 1)) + np.where(np.arange(count) % 8 == 7, 150, 0)[:, None, None]
        )
        yaw = np.repeat(np.round(euler[:, :1, 2:]) + off, length, axis=1)
        yaw[::2, 2 * length // 3 :] += 25.0  # while the vehicle levels out, no set-point arrives
        yaw, euler[..., 2] = ((angle + 180.0) % 360.0 - 180.0 for angle in (yaw, euler[..., 2]))
        level = np.zeros((count, length, 1))
        level[::3, 5:10] = 1.0  # multiples of the position loop's period, like the supervisor's 40 ms
        rows = np.concatenate([euler, gyro, velocity, wanted, yaw, level], axis=-1).astype(np.float32)
        out = np.zeros((count, length, 4), np.float32)
        for i in range(count):
            lib.pid_boot()
            for k in range(length):
                lib.harness_pid(2 * k, floats(rows[i, k]), floats(out[i, k]))
        sets[f"{name}_rows"], sets[f"{name}_out"] = rows, out
    np.savez_compressed(DATA / "firmware_pid.npz", **sets)
    return sets["short_out"]


def mixer(lib, rng):
    """Return cases of the mixer: thrust from zero to twice the maximum, all moments."""
    count = 4000
    thrust = np.round(rng.uniform(0.0, 90000.0, count) * 16.0).astype(np.float32) / np.float32(16.0)
    moments = (rng.uniform(-1.0, 1.0, (count, 3)) * rng.choice([500, 8000, 16000, 32000], (count, 1))).astype(
        np.int16
    )
    out = np.zeros((count, 4), np.uint16)
    for t, m, o in zip(thrust, moments, out, strict=True):
        lib.harness_mixer(
            ctypes.c_float(t),
            m.ctypes.data_as(ctypes.POINTER(ctypes.c_int16)),
            o.ctypes.data_as(ctypes.POINTER(ctypes.c_uint16)),
        )
    np.savez_compressed(DATA / "firmware_mixer.npz", thrust=thrust, moments=moments, out=out)
    return out


ACCELERATIONS_G = ((0.0, 0.0, 1.0), (0.3, -0.2, 0.45), (0.0, 0.1, -0.6), (0.02, 0.01, 0.05), (0.1, 0.0, 0.6))


def supervisor(lib, rng):
    """Return cases of the supervisor at 25 Hz: motors, set-point age, acceleration and requests in phases.

    Columns: action before the update, motors running, set-point age in ms, index of the acceleration.
    """
    count, length = 80, 500
    rows = np.zeros((count, length, 4), np.int32)
    out = np.zeros((count, length), np.uint8)
    for i in range(count):
        lib.sup_boot()
        state, motors, accel, newest, armed_at = 0, 0, 0, 0, -1000
        sending, restart = True, 0.01 if i % 2 else 0.1
        for k in range(length):
            name = STATES[state]
            now = 40 * k
            action = NOTHING
            if (
                name == "PreFlChecksPassed"
                and rng.random() < 0.3
                and now - armed_at > 2100
                and not motors
                and accel == 0
            ):
                action = ARM
            elif name == "ReadyToFly" and rng.random() < 0.02:
                action = DISARM
            elif name == "Crashed" and accel in (0, 4) and rng.random() < 0.2:
                action = RECOVER
            if rng.random() < (0.03 if motors else restart):
                motors = 1 - motors
            if name not in ("ReadyToFly", "Flying", "WarningLevelOut", "Landed"):
                motors = 0
            if motors:
                armed_at = now
            if rng.random() < 0.02:
                sending = not sending
            elif not sending and rng.random() < 0.04:
                sending = True
            if sending:
                newest = now
            if rng.random() < (0.015 if accel == 0 else 0.12):
                accel = int(rng.choice(5, p=(0.5, 0.15, 0.1, 0.15, 0.1)))
            rows[i, k] = action, motors, now - newest, accel
            if action == ARM:
                assert lib.harness_arm(1)
            elif action == DISARM:
                assert lib.harness_arm(0)
            elif action == RECOVER:
                action = RECOVER if lib.harness_recover() else NOTHING
                rows[i, k, 0] = action
            a = [ctypes.c_float(v) for v in ACCELERATIONS_G[accel]]
            state = lib.harness_supervisor(1000 + now, now - newest, motors, *a)
            out[i, k] = state
    np.savez_compressed(
        DATA / "firmware_supervisor.npz", rows=rows, out=out, states=STATES, accelerations_g=ACCELERATIONS_G
    )
    return out


def main() -> None:
    lib = ctypes.CDLL(str(Path(sys.argv[1]).resolve()))
    DATA.mkdir(exist_ok=True)
    for k, function in enumerate((mellinger, pid, mixer, supervisor)):
        out = function(lib, np.random.default_rng([SEED, k]))
        print(function.__name__, out.shape, np.unique(out)[:12])


if __name__ == "__main__":
    main()
