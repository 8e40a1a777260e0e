"""Makes the tables of docs/how_it_works/vehicle.md: rows of simulated number, reference and deviation.

``python -m tests.benchmarks vehicle_tables`` writes them into the page.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sim.plant.rotors import BatteryModel
from tests import linear_analysis as analysis
from tests.benchmarks.vehicle import reference as ref
from tests.benchmarks.vehicle import runs as runs
from tests.benchmarks.vehicle.responses import (
    NAMES,
    ROTOR,
    WEIGHT_N,
    Step,
    hover,
    increase,
    landing,
    rise_s,
    roll,
    touch_index,
    velocity,
    yaw,
)

F64 = npt.NDArray[np.float64]
PAGE = Path(__file__).parents[3] / "docs" / "how_it_works" / "vehicle.md"
BLOCK = re.compile(r"(<!-- table (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
STANDING_ROTORS_M = ROTOR.above_com_m - analysis.PARAMS.geometry.foot_bottom_m


@dataclass(frozen=True)
class Row:
    """One row of the comparison; ``digits``: number of printed decimals."""

    what: str
    unit: str
    simulated: float
    reference: float
    source: str
    digits: int = 3

    def cells(self) -> str:
        deviation = round(100.0 * (self.simulated / self.reference - 1.0), 1) + 0.0  # turns -0.0 into 0.0
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"| {self.what} | {self.simulated:.{self.digits}f}{unit} "
            f"| {self.reference:.{self.digits}f}{unit} | {deviation:+.1f} % | {self.source} |"
        )


def hover_rows() -> Iterable[Row]:
    """Yield the table rows about hover: static rotor maps and battery."""
    run = hover()
    early = run.rpm[(run.t > 1.0) & (run.t < 30.0)]
    thrust = np.vectorize(ROTOR.thrust_n)(early)
    grams = 1000.0 * analysis.MASS
    yield Row("rotor speed, 31.9 g", "rpm", early.mean(), ref.L250_HOVER_RPM, "L250 curve, by hand", 0)
    yield Row("rotor speed, 31.9 g", "rpm", early.mean(), ref.bench_rpm(grams), "Bitcraze bench fit", 0)
    yield Row("thrust of the four rotors", "N", 4.0 * thrust.mean(), WEIGHT_N, "weight", 4)
    counts = thrust.mean() / analysis.N_PER_COUNT
    yield Row("thrust command per motor", "counts", counts, ref.L250_HOVER_COUNTS, "firmware scale", 0)
    share = 4.0 * ROTOR.thrust_max_n / WEIGHT_N
    yield Row("largest thrust over weight", "", share, 4.0 * 0.12 / (0.0319 * 9.81), "firmware, L250", 3)
    for bench_grams, rpm, duty, volts in ref.BENCH:
        grams_here = 4000.0 * ROTOR.thrust_n(rpm) / analysis.G
        yield Row(f"thrust of the four at {rpm:.0f} rpm", "g", grams_here, bench_grams, "Bitcraze bench", 1)
        battery = BatteryModel(analysis.PARAMS.battery, analysis.HOVER_RPM)
        battery.record.voltage_v = duty * volts
        what = f"rotor speed at {duty * volts:.2f} V on the motor"
        yield Row(what, "rpm", battery.rpm_max, rpm, "Bitcraze bench", 0)
    empty = float(run.t[np.argmax(run.battery_v <= run.battery_v[-1] + 1e-6)])
    yield Row(
        "hover until the battery is empty", "s", empty, ref.DATA_SHEET_HOVER_S, "Bitcraze data sheet", 0
    )


def motor_rows() -> Iterable[Row]:
    h = analysis.HOVER_RPM
    small = 0.02 * h

    def tau(slow: bool, way: float) -> float:
        t, rpm = runs.motor_step(slow, h, h + way * small, 1.0)
        done = (rpm - h) / (way * small)
        return float(np.interp(1.0 - math.exp(-1.0), done, t))

    yield Row("time constant, nominal", "s", tau(False, 1.0), ref.FOERSTER_LAG_S, "Foerster 2015", 4)
    yield Row("time constant, nominal", "s", tau(False, 1.0), ref.ESCHMANN_LAG_S, "Eschmann (in rotorpy)", 4)
    yield Row("time constant, slow, rising", "s", tau(True, 1.0), ref.L250_RISE_S, "L250", 4)
    yield Row("time constant, slow, falling", "s", tau(True, -1.0), ref.L250_FALL_S, "L250", 4)
    full = BatteryModel(analysis.PARAMS.battery, h)
    full.record.voltage_v = 4.0
    for slow, name in NAMES.items():
        t, rpm = runs.motor_step(slow, 0.0, full.rpm_max, 1.0)
        seconds = float(t[np.argmax(rpm >= 25000.0)])
        yield Row(f"0 to 25000 rpm at 4.0 V, {name}", "s", seconds, ref.BENCH_STEP_S, "Bitcraze step test", 3)


def mode_rows(name: str, step: Step) -> Iterable[Row]:
    (wn, zeta), (w0, z0) = step.modes
    yield Row(f"{name}: natural frequency", "rad/s", wn, w0, "linear model", 2)
    yield Row(f"{name}: damping ratio", "", zeta, z0, "linear model", 3)


def roll_rows() -> Iterable[Row]:
    for slow, name in NAMES.items():
        yield from mode_rows(f"Mellinger, {name}", roll(slow))
    for slow, name in NAMES.items():
        step = roll(slow)
        half = [1000.0 * float(np.interp(-0.5, -y, step.t)) for y in (step.simulated, step.linear)]
        yield Row(f"Mellinger, {name}: time to half", "ms", *half, "linear model", 1)


def velocity_rows() -> Iterable[Row]:
    for axis, way in ((0, "horizontal"), (2, "vertical")):
        for slow, motors in NAMES.items():
            step = velocity(slow, axis)
            end = float(step.linear[-1])
            name = f"{way}, paper, {motors}"
            times = [1000.0 * rise_s(step.t, y, end) for y in (step.simulated, step.linear)]
            peaks = [float(y.max()) for y in (step.simulated, step.linear)]
            yield Row(f"{name}: rise 10 to 90 %", "ms", *times, "linear model", 0)
            yield Row(f"{name}: peak over set-point", "", *peaks, "linear model", 3)
            yield from mode_rows(name, step)
        step = velocity(False, axis, late=True)
        peaks = [float(y.max()) for y in (step.simulated, step.linear)]
        yield Row(f"{way}, paper, motion capture 10 ms late: peak", "", *peaks, "the same", 3)


def yaw_rows() -> Iterable[Row]:
    for slow, name in NAMES.items():
        step = yaw(slow)
        yield from mode_rows(name, step)
        peaks = [float(y.max()) for y in (step.simulated, step.linear)]
        yield Row(f"{name}: peak over set-point", "", *peaks, "linear model", 3)


def touchdown_rows() -> Iterable[Row]:
    """Yield the table rows about the touchdown from the last centimetres."""
    rest = -analysis.PARAMS.geometry.foot_bottom_m
    for speed, drop, driving in (
        (0.2, False, False), (0.3, False, False), (0.2, False, True), (0.2, True, False), (0.2, True, True),
    ):  # fmt: skip
        run = landing(speed, drop, driving)
        at = touch_index(run)
        begin = 0.05 - rest if drop else 0.2
        _, expected = ref.descend(begin, speed, motors_off=drop)
        pad = "driving pad" if driving else "standing pad"
        rule = "motors off at 5 cm" if drop else "by contact"
        touch = -float(run.relative_velocity[at - 1, 2])
        name = f"touch at {speed} m/s {rule}, {pad}"
        yield Row(name, "m/s", touch, expected, "point mass", 3)
    run = landing(0.2, False, False)
    height = 1000.0 * float(run.relative[-1, 2])
    yield Row("centre of mass at rest over the pad", "mm", height, 1000.0 * rest, "CAD", 2)
    gain = float(run.ground_factor[touch_index(run) - 1])
    ideal = float(ref.cheeseman_bennett(np.array(STANDING_ROTORS_M)))
    yield Row("ground-effect factor at touch", "", gain, ideal, "Cheeseman-Bennett", 4)
    ride = landing(0.2, False, True)
    speed = float(np.hypot(*(ride.velocity[-1, :2])))
    yield Row("speed of the vehicle standing on the driving pad", "m/s", speed, 0.1, "pad", 4)


HEIGHTS_M = (STANDING_ROTORS_M, 0.03, 0.05, 0.0693, 0.08)
CURVES: dict[str, Callable[[F64], F64]] = {
    "Cheeseman-Bennett 1955": ref.cheeseman_bennett,
    "Sanchez-Cuevas 2017, K_b = 0": lambda h: ref.sanchez_cuevas(h, 0.0),
    "Sanchez-Cuevas 2017, K_b = 2": lambda h: ref.sanchez_cuevas(h, 2.0),
    "gym-pybullet-drones": ref.pybullet_drones,
}


def ground_rows() -> Iterable[Row]:
    for h in HEIGHTS_M:
        for name, curve in CURVES.items():
            values = [100.0 * increase(h), 100.0 * (float(curve(np.array(h))) - 1.0)]
            yield Row(f"more thrust, rotor {1000.0 * h:.1f} mm high", "%", *values, name, 2)


HEAD = "| quantity | simulated | reference | deviation | source of the reference |\n|---|---|---|---|---|"
COMPARISONS: dict[str, Callable[[], Iterable[Row]]] = {
    "hover": hover_rows,
    "motors": motor_rows,
    "roll": roll_rows,
    "velocity": velocity_rows,
    "yaw": yaw_rows,
    "touchdown": touchdown_rows,
    "ground": ground_rows,
}


def tables() -> dict[str, str]:
    """Return all tables by their names in the page."""
    return {name: "\n".join([HEAD, *(row.cells() for row in rows())]) for name, rows in COMPARISONS.items()}


def written_tables() -> dict[str, str]:
    """Return the current tables of the page, by name."""
    return {match[2]: match[3].rstrip("\n") for match in BLOCK.finditer(PAGE.read_text())}


def main() -> None:
    fresh = tables()
    PAGE.write_text(BLOCK.sub(lambda match: f"{match[1]}{fresh[match[2]]}\n{match[4]}", PAGE.read_text()))
    print(f"{PAGE}: {len(fresh)} tables")
