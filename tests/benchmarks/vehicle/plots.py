"""Draws the figures of docs/how_it_works/vehicle.md.

Simulated lines are solid, references are dashed; each colour has the same meaning in all figures.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import welch

from logs.report.style import BOUNDARY, COMMAND, GRID, INK, LIMIT, NOMINAL, TARGET, TRUE
from tests import linear_analysis as analysis
from tests.benchmarks.vehicle import reference as ref
from tests.benchmarks.vehicle import runs as runs
from tests.benchmarks.vehicle.responses import (
    GUST_RMS_M_S,
    GUST_STEP_S,
    NAMES,
    PAPER,
    PID,
    ROTOR,
    Step,
    gusts,
    hover,
    increase,
    landing,
    roll,
    touch_index,
    velocity,
    yaw,
)

F64 = npt.NDArray[np.float64]
POINTS_MAX = 250  # maximum points of a line: more are not visible, and the files must stay small
COLORS = {False: TRUE, True: BOUNDARY}  # nominal motors, slow motors
STYLE = {
    "svg.hashsalt": "vehicle",  # makes the file reproducible
    "font.size": 9.0, "axes.titlesize": 9.5, "legend.fontsize": 8.0, "legend.frameon": False,
    "axes.edgecolor": "#9aa5b1", "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.grid": True, "grid.color": GRID, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False, "lines.linewidth": 1.5,
}  # fmt: skip
WIDTH_IN = 8.0


def panels(
    rows: int, columns: int, height_in: float, **more: object
) -> tuple[Figure, npt.NDArray[np.object_]]:
    """Return an empty figure and its axes, always as a two-dimensional array."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained", facecolor="white")
    return figure, figure.subplots(rows, columns, squeeze=False, **more)


def line(axes: Axes, x: F64, y: F64, color: str, label: str | None = None, *, dashed: bool = False) -> None:
    every = max(1, len(x) // POINTS_MAX)
    axes.plot(
        x[::every], y[::every], "--" if dashed else "-", color=color, label=label, lw=1.2 if dashed else 1.6
    )


def label(axes: Axes, x: str, y: str, title: str) -> None:
    """Set title and labels of the axes."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, loc="left")


def pair(axes: Axes, step: Step, slow: bool, until_s: float) -> None:
    """Draw a simulated response and its linear model."""
    shown = step.t <= until_s
    line(axes, 1000.0 * step.t[shown], step.simulated[shown], COLORS[slow], NAMES[slow])
    line(axes, 1000.0 * step.t[shown], step.linear[shown], INK, "linear model" if slow else None, dashed=True)


def hover_figure() -> Figure:
    """Draw thrust curve and battery."""
    figure, ((left, right),) = panels(1, 2, 3.0)
    rpm = np.linspace(8000.0, 25000.0, 120)
    grams = 4000.0 / analysis.G * np.vectorize(ROTOR.thrust_n)(rpm)
    a, b, c = ref.BENCH_FIT
    line(left, rpm, grams, TRUE, "simulated (L250)")
    line(left, rpm, (a * rpm + b) * rpm + c, INK, "Bitcraze bench fit", dashed=True)
    left.plot(
        [p[1] for p in ref.BENCH], [p[0] for p in ref.BENCH], "s", color=INK, ms=5, label="Bitcraze bench"
    )
    left.plot(
        [analysis.HOVER_RPM], [1000.0 * analysis.MASS], "o", color=BOUNDARY, ms=6, label="hover, 31.9 g"
    )
    left.legend(loc="upper left")
    label(left, "rotor speed [rpm]", "thrust of four rotors [g]", "Static thrust")
    run = hover()
    line(right, run.t, run.battery_v, TRUE, "under load, hovering")
    right.axvline(ref.DATA_SHEET_HOVER_S, color=INK, ls="--", lw=1.2, label="flight time by the data sheet")
    right.set_xlim(0.0, 440.0)
    right.legend(loc="lower left")
    label(right, "time in hover [s]", "battery voltage [V]", "Battery")
    return figure


def motors_figure() -> Figure:
    """Draw steps of the rotor speed."""
    figure, ((left, right),) = panels(1, 2, 3.0)
    full = analysis.PARAMS.battery.speed_at_zero_v_rpm + 4.0 * analysis.PARAMS.battery.speed_per_volt_rpm
    h = analysis.HOVER_RPM
    for slow, name in NAMES.items():
        t, rpm = runs.motor_step(slow, 0.0, full, 0.4)
        line(left, 1000.0 * t, 0.001 * rpm, COLORS[slow], name)
        for way in (1.0, -1.0):
            t, rpm = runs.motor_step(slow, h, h * (1.0 + 0.1 * way), 0.4)
            line(right, 1000.0 * t, 0.001 * rpm, COLORS[slow], name if way > 0.0 else None)
    left.plot([1000.0 * ref.BENCH_STEP_S], [25.0], "s", color=INK, label="Bitcraze step test")
    left.legend(loc="lower right")
    label(left, "time [ms]", "rotor speed [1000 rpm]", "Full throttle at 4.0 V, from rest")
    for tau, name, style in ((ref.FOERSTER_LAG_S, "first order, 0.065 s (Foerster)", "--"),
                             (ref.L250_RISE_S, "first order, 0.136 s (L250)", ":")):  # fmt: skip
        t = np.linspace(0.0, 0.4, 80)
        right.plot(
            1000.0 * t, 0.001 * h * (1.1 - 0.1 * np.exp(-t / tau)), style, color=INK, lw=1.2, label=name
        )
    right.legend(loc="center right")
    label(right, "time [ms]", "rotor speed [1000 rpm]", "Steps of 10 % around hover")
    return figure


def roll_figure() -> Figure:
    """Draw roll after a release at 10 degrees."""
    figure, (row,) = panels(1, 2, 3.0, sharey=True)
    for axes, loop, title in zip(
        row, (PAPER, PID), ("Mellinger attitude (paper's gains)", "PID attitude"), strict=True
    ):
        for slow in (False, True):
            pair(axes, roll(loop, slow), slow, 0.6)
        label(axes, "time [ms]", "roll / 10° [-]" if loop is PAPER else "", title)
    row[0].legend()
    return figure


def velocity_figure() -> Figure:
    figure, grid = panels(2, 2, 5.2, sharex=True, sharey="row")
    for row, (axis, way) in zip(grid, ((0, "Horizontal"), (2, "Vertical")), strict=True):
        for axes, loop, title in zip(row, (PAPER, PID), ("paper's loop", "PID loop"), strict=True):
            for slow in (False, True):
                pair(axes, velocity(loop, slow, axis), slow, 1.2)
            x = "time [ms]" if axis == 2 else ""
            label(axes, x, "velocity / set-point [-]" if loop is PAPER else "", f"{way}, {title}")
    grid[0][0].legend(loc="lower right")
    return figure


def yaw_figure() -> Figure:
    """Draw yaw steps with the paper's gains."""
    figure, ((axes,),) = panels(1, 1, 2.8)
    for slow in (False, True):
        pair(axes, yaw(slow), slow, 4.0)
    axes.legend(loc="lower right")
    label(axes, "time [ms]", "yaw / set-point [-]", "Yaw step of 0.3 rad, paper's gains")
    return figure


def touchdown_figure() -> Figure:
    """Draw the last ten centimetres of a descent."""
    figure, grid = panels(3, 2, 6.0, sharex="col", sharey="row")
    for column, drop, title in ((0, False, "By contact, 0.2 m/s"), (1, True, "Motors off 5 cm up (paper)")):
        for driving, color, name in ((False, TRUE, "standing pad"), (True, BOUNDARY, "pad driving 0.1 m/s")):
            run = landing(0.2, drop, driving)
            at = touch_index(run)
            height = 1000.0 * (run.relative[:, 2] + analysis.PARAMS.geometry.foot_bottom_m)
            below = int(np.argmax(height < 100.0))
            shown = slice(below, at + 250)
            ms = 1000.0 * (run.t[shown] - run.t[at])
            line(grid[0][column], ms, height[shown], color, name, dashed=driving)
            line(grid[1][column], ms, run.relative_velocity[shown, 2], color, dashed=driving)
            line(grid[2][column], ms, run.ground_factor[shown], color, dashed=driving)
        for axes in grid[:, column]:
            axes.axvspan(0.0, ms[-1], color="#009E73", alpha=0.10, lw=0, label="after the first touch")
        label(grid[0][column], "", "" if column else "feet over the pad [mm]", title)
        label(grid[1][column], "", "" if column else "vertical speed [m/s]", "")
        label(
            grid[2][column],
            "time after the first touch [ms]",
            "" if column else "ground-effect factor [-]",
            "",
        )
    grid[0][0].legend(loc="upper right")
    return figure


def ground_figure() -> Figure:
    """Draw ground effect and published curves."""
    figure, ((axes,),) = panels(1, 1, 3.4)
    h = np.linspace(0.012, 0.12, 220)
    low, high = ([100.0 * increase(x, gain) for x in h] for gain in (1.0, 4.0))
    axes.fill_between(1000.0 * h, low, high, color=TRUE, alpha=0.12, lw=0, label="simulated, gain 1 to 4")
    line(axes, 1000.0 * h, np.array(low), TRUE, "simulated, gain 1 (default)")
    curves: tuple[tuple[str, str, Callable[[F64], F64]], ...] = (
        ("Cheeseman-Bennett 1955", INK, ref.cheeseman_bennett),
        ("Sanchez-Cuevas 2017, $K_b$ = 0", COMMAND, lambda x: ref.sanchez_cuevas(x, 0.0)),
        ("Sanchez-Cuevas 2017, $K_b$ = 2", NOMINAL, lambda x: ref.sanchez_cuevas(x, 2.0)),
        ("gym-pybullet-drones", TARGET, ref.pybullet_drones),
    )
    for name, color, curve in curves:
        line(axes, 1000.0 * h, 100.0 * (curve(h) - 1.0), color, name, dashed=True)
    standing = 1000.0 * (ROTOR.above_com_m - analysis.PARAMS.geometry.foot_bottom_m)
    axes.axvline(standing, color=LIMIT, lw=1.0, ls=":", label="standing on the pad")
    axes.set_ylim(0.0, 30.0)
    axes.set_xlim(12.0, 120.0)
    axes.legend(loc="upper right")
    label(axes, "height of the rotor over the surface [mm]", "more thrust [%]", "Ground effect")
    return figure


def wind_figure() -> Figure:
    """Draw the spectrum of the gusts."""
    figure, ((axes,),) = panels(1, 1, 3.0)
    shape, wind = analysis.PARAMS.wind, gusts()
    for axis, rms, time_s, color, name in (
        (0, GUST_RMS_M_S, shape.horizontal_time_s, TRUE, "horizontal"),
        (2, GUST_RMS_M_S * shape.vertical_share, shape.vertical_time_s, BOUNDARY, "vertical"),
    ):
        f, density = welch(wind[:, axis], 1.0 / GUST_STEP_S, nperseg=16384)
        shown = np.unique(np.geomspace(1, len(f) - 1, 150).astype(int))
        line(axes, f[shown], density[shown], color, f"simulated, {name}")
        line(
            axes,
            f[shown],
            ref.gust_density(f[shown], rms, time_s),
            INK,
            "first order" if axis else None,
            dashed=True,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(0.02, 50.0)
    axes.set_ylim(2e-6, 10.0)
    axes.legend(loc="lower left")
    label(axes, "frequency [Hz]", "power density [m²/s²/Hz]", "Gusts, 0.6 m/s rms")
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "hover": hover_figure,
    "motors": motors_figure,
    "roll": roll_figure,
    "velocity": velocity_figure,
    "yaw": yaw_figure,
    "touchdown": touchdown_figure,
    "ground_effect": ground_figure,
    "wind": wind_figure,
}


def draw(folder: Path, kind: str = "svg") -> list[Path]:
    """Write all figures as ``vehicle_NAME.svg``; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with mpl.rc_context(STYLE):
        for name, make in FIGURES.items():
            files.append(folder / f"vehicle_{name}.{kind}")
            make().savefig(files[-1], metadata={"Date": None} if kind == "svg" else None, dpi=110)
    return files
