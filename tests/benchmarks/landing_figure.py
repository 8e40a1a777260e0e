"""Draws the landing at the top of the README from a new flight.

``python -m tests.benchmarks landing_animation`` writes docs/figures/landing.gif, an animation of the same
landing. ``python -m tests.benchmarks landing_figure`` flies one seed of a scenario in this process and writes
docs/figures/landing.svg. The same code always writes the same file.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from flightstack.core.safety.barrier import Barrier
from logs.reader.flight_data import Truth
from logs.report.style import BOUNDARY, GRID, INK, TARGET, TRUE
from sim.plant.params import load as load_plant
from sim.runners.landing import Landing, land
from sim.scenarios.scenario import Scenario, load
from sim.scenarios.tables import StartKind

FILE = Path(__file__).parents[2] / "docs" / "figures" / "landing.svg"
FILM = FILE.with_suffix(".gif")
FRAMES_HZ = 15.0
AFTER_S = 1.0  # time shown after the first contact, s
SEED = 1
START_OFFSET_M = (-1.3, 0.0, 0.8)  # offset from the landing spot, ENU; the robot drives in this plane
BEFORE_S = (4.0, 2.0, 0.0)  # times before the first contact at which robot and barrier are drawn, s
REACH_M = 1.0  # distance on both sides of the robot over which a barrier is drawn, m
POINTS_MAX = 300  # maximum points of a line; more are not visible
STYLE = {
    "svg.hashsalt": "landing",  # fixes the ids in the file, so that the file is reproducible
    "font.size": 9.0, "axes.titlesize": 9.5, "legend.fontsize": 8.0, "legend.frameon": False,
    "axes.edgecolor": "#9aa5b1", "axes.labelcolor": INK, "text.color": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.grid": True, "grid.color": GRID, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False, "lines.linewidth": 1.5,
}  # fmt: skip


def scenario() -> Scenario:
    """Return scenario ``straight`` with a start behind the robot: the flight stays in a vertical plane."""
    stock = load("straight")
    return replace(stock, start=replace(stock.start, kind=StartKind.HOVER, offset_m=START_OFFSET_M))


def side_view(axes: Axes, truth: Truth, barrier: Barrier, touch_s: float) -> None:
    """Draw both paths from the side, and robot and barrier at three times."""
    robot = load_plant("crazyflie20").robot
    x, z = truth.position_enu_m[:, 0], truth.position_enu_m[:, 2]
    shown = thinned(truth.t_s <= touch_s)
    axes.plot(x[shown], z[shown], color=TRUE, lw=1.8, label="path of the vehicle")
    d = np.linspace(-REACH_M, REACH_M, 161)
    boundary = np.array([barrier.height(abs(float(each))) for each in d])
    for before_s in BEFORE_S:
        at = int(np.searchsorted(truth.t_s, touch_s - before_s))
        pad_x, _, pad_z = truth.pad_position_enu_m[at]
        shade = 1.0 - 0.2 * before_s
        axes.fill_between(pad_x + d, 0.0, pad_z + boundary, color=BOUNDARY, alpha=0.06 * shade, lw=0)
        axes.plot(pad_x + d, pad_z + boundary, color=BOUNDARY, lw=1.2, alpha=shade)
        corner = (pad_x - 0.5 * robot.body_length_m, robot.ground_clearance_m)
        axes.add_patch(
            Rectangle(corner, robot.body_length_m, pad_z - corner[1], color=TARGET, alpha=shade, lw=0)
        )
        axes.plot(x[at], z[at], "o", color=TRUE, ms=5)
        name = "touchdown" if not before_s else f"{before_s:.0f} s before"
        axes.annotate(name, (x[at], z[at]), (4, 6), textcoords="offset points", fontsize=8.0)
    axes.plot([], [], color=BOUNDARY, lw=1.2, label="boundary h = 0: it moves with the robot")
    axes.set_ylim(0.0, 1.4)
    axes.set_aspect("equal")
    axes.legend(loc="upper right", borderaxespad=0.1)
    axes.set(xlabel="east [m]", ylabel="height [m]")
    axes.set_title("A landing from the side; the robot drives east at 0.2 m/s", loc="left")


def barrier_value(axes: Axes, truth: Truth, touch_s: float, pad_radius_m: float) -> None:
    """Draw h from true states over time."""
    shown = thinned(truth.t_s <= touch_s)
    t_s = truth.t_s[shown] - touch_s
    over = truth.d_m[shown] <= pad_radius_m
    axes.plot(t_s, truth.h_m[shown], color=TRUE, lw=1.6)
    axes.axhline(0.0, color=BOUNDARY, lw=1.2)
    if over.any():
        axes.axvspan(float(t_s[np.argmax(over)]), 0.0, color=TARGET, alpha=0.15, lw=0)
        axes.annotate("over the pad", (float(t_s[np.argmax(over)]), 0.95), (-4, 0), ha="right", fontsize=8.0,
                      xycoords=("data", "axes fraction"), textcoords="offset points")  # fmt: skip
    axes.set(xlabel="time before touchdown [s]", ylabel="h [m]")
    axes.set_title("Barrier: safe above 0", loc="left")


def thinned(which: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Return the indices of the selected rows, thinned to about ``POINTS_MAX``."""
    wanted = np.flatnonzero(which)
    return wanted[:: max(1, len(wanted) // POINTS_MAX)]


def draw(landing: Landing, barrier: Barrier, file: Path) -> None:
    """Write the figure of a landing."""
    truth = landing.seen.truth
    touch_s = float(truth.first_touch_time_s[-1])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.5, 2.9), layout="constrained", facecolor="white")
        left, right = figure.subplots(1, 2, width_ratios=(2.9, 1.0))
        side_view(left, truth, barrier, touch_s)
        barrier_value(right, truth, touch_s, landing.seen.pad_radius_m)
        figure.savefig(file, metadata={"Date": None})


def animate(landing: Landing, barrier: Barrier, file: Path) -> None:
    """Write an animation of a landing from the side, in real time."""
    truth, robot = landing.seen.truth, load_plant("crazyflie20").robot
    touch_s = float(truth.first_touch_time_s[-1])
    times_s = np.arange(truth.t_s[0], touch_s + AFTER_S, 1.0 / FRAMES_HZ)
    d = np.linspace(-REACH_M, REACH_M, 81)
    boundary = np.array([barrier.height(abs(float(each))) for each in d])
    x, z = truth.position_enu_m[:, 0], truth.position_enu_m[:, 2]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 2.6), layout="constrained", facecolor="white", dpi=100)
        axes = figure.subplots()

        def frame(t_s: float) -> None:
            at = min(int(np.searchsorted(truth.t_s, t_s)), len(truth.t_s) - 1)
            pad_x, _, pad_z = truth.pad_position_enu_m[at]
            axes.clear()
            axes.fill_between(pad_x + d, 0.0, pad_z + boundary, color=BOUNDARY, alpha=0.06, lw=0)
            axes.plot(pad_x + d, pad_z + boundary, color=BOUNDARY, lw=1.2)
            low = robot.ground_clearance_m
            axes.add_patch(Rectangle((pad_x - 0.5 * robot.body_length_m, low), robot.body_length_m,
                                     pad_z - low, color=TARGET, lw=0))  # fmt: skip
            axes.plot(x[: at + 1 : 4], z[: at + 1 : 4], color=TRUE, lw=1.2, alpha=0.6)
            axes.plot([x[at] - 0.06, x[at] + 0.06], [z[at], z[at]], color=TRUE, lw=4.0)
            axes.set(xlim=(float(x.min()) - 0.2, float(x.max()) + 0.6), ylim=(0.0, 1.4), xlabel="east [m]",
                     ylabel="height [m]")  # fmt: skip
            axes.set_aspect("equal")
            axes.set_title(f"h = {truth.h_m[at]:+.2f} m, {touch_s - t_s:.1f} s before touchdown"
                           if t_s < touch_s else "landed", loc="left")  # fmt: skip

        film = FuncAnimation(figure, frame, frames=times_s, blit=False, cache_frame_data=False)
        film.save(file, writer=PillowWriter(fps=FRAMES_HZ))


def animation() -> None:
    flown = scenario()
    animate(land(flown, SEED), flown.onboard.barrier.build(), FILM)
    print(f"{FILM}: {FILM.stat().st_size / 1024:.0f} KB")


def main() -> None:
    flown = scenario()
    landing = land(flown, SEED)
    print(f"{landing.verdict.outcome}: {landing.verdict.reason}")
    draw(landing, flown.onboard.barrier.build(), FILE)
    print(f"{FILE}: {FILE.stat().st_size / 1024:.0f} KB")
