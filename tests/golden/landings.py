"""Golden landings: stored results of landings in one process; the test shows any change of the simulator.

``python -m tests.golden.landings [NAME ...]`` flies the named landings, or all, and writes ``landings.json``.
Use it after a change of simulated vehicle, autopilot, robot, links or faults that is meant to change flights.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import flightstack as fs
from sim.campaign.rows import row_of
from sim.runners.landing import Landing, land
from sim.scenarios.fault_spec import TABLE, After, Fault, Kind, What
from sim.scenarios.scenario import Scenario, load, names

FILE = Path(__file__).with_name("landings.json")
TIERS = ("lab", "room", "field", "storm", "deck")
# name of a variant: scenario of the package, and the keys that the variant changes
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "pid": ("lab", {"vehicle.velocity_loop": "pid"}),
    "slow motors": ("lab", {"vehicle.slow_motors": True, "vehicle.motor_lag_spread": 0.3}),
    "known drag": ("lab", {"vehicle.velocity_loop": "pid", "vehicle.known_drag_1_s": [0.46, 0.46, 0.4]}),
    "ground effect": ("lab", {"vehicle.ground_effect_gain": 4.0}),
    "tired": ("field", {"vehicle.airframe": "crazyflie21_room", "vehicle.battery_charge": [0.2, 0.2],
                        "vehicle.motor_spread": 0.1}),
    "windy": ("lab", {"wind.mean_m_s": 1.0, "wind.gust_rms_m_s": 0.6}),
    "poor capture": ("lab", {"vehicle.mocap.loss": 0.2, "vehicle.mocap.dropout_every_s": 0.7,
                             "vehicle.mocap.dropout_max_s": 0.3, "vehicle.mocap.delay_s": 0.03}),
    "late set-points": ("lab", {"vehicle.setpoint_delay_s": 0.05}),
    "circle": ("lab", {"target.path": "circle", "target.turn_rate_rad_s": 0.3}),
    "figure of eight": ("lab", {"target.path": "figure_of_eight", "target.turn_rate_rad_s": 0.5}),
    "stop and go": ("lab", {"target.path": "stop_and_go"}),
    "waypoints": ("lab", {"target.path": "waypoints", "target.turn_rate_rad_s": 1.0,
                          "target.waypoints_m": [[0.5, 0.0], [0.5, 0.5], [0.0, 0.0]]}),
    "behind the axle": ("lab", {"target.path": "circle", "target.turn_rate_rad_s": 0.3,
                                "target.pad_behind_axle_m": 0.032}),
    "heave": ("straight", {"target.heave_amplitude_m": 0.1, "target.heave_rate_hz": 0.3}),
    "late robot": ("reversing", {"odometry.error": {}}),
    "late states": ("lab", {"vehicle.own": {"delay_s": 0.05, "delay_shared": True, "tilt_rad": 0.03},
                            "odometry.error": {"delay_s": 0.05, "delay_shared": True}}),
}  # fmt: skip
# columns of the true states; a result contains the mean absolute value of each column
COLUMNS = (
    "position_enu_m", "velocity_enu_m_s", "orientation", "angular_velocity_flu_rad_s", "rotor_rpm",
    "pad_position_enu_m", "pad_velocity_enu_m_s", "pad_yaw_rad", "h_m", "contacts", "battery_v",
    "wind_enu_m_s",
)  # fmt: skip
OF_ROBOT = (What.TARGET_ODOMETRY, What.ROBOT)
IN_TAKEOFF = (  # faults that are also flown in a take-off from the ground
    (What.MOTOR, Kind.WEAK), (What.MOCAP, Kind.OFF), (What.LINK_OUT, Kind.OFF), (What.SETPOINTS, Kind.OFF),
    (What.CLOCK, Kind.STUCK),
)  # fmt: skip
OMITTED = ("cells", "wall_s", "seed")  # fields of a campaign row that are not compared


def faulty(what: What, kind: Kind, *, in_takeoff: bool = False) -> Scenario:
    """Return scenario ``grid`` with one fault, in take-off from the ground or in an approach from hover."""
    keys: dict[str, Any] = {"duration_max_s": 15.0, "retreat.abort_time_max_s": 5.0}
    hover = {"start.kind": "hover", "start.offset_m": [-0.7, 0.3, 0.65]}
    grid = fs.scenario("grid", keys if in_takeoff else keys | hover)
    given: dict[str, Any] = {"motor": 2} if what is What.MOTOR else {}
    given |= {"offset_m": (0.3, 0.0, 0.0)} if TABLE[what][kind].offset else {}
    if in_takeoff:
        given |= {"start_s": 2.0, "after": After.TAKEOFF}
    else:
        given |= {"start_s": 0.5, "after": After.LANDING} if what in OF_ROBOT else {"start_s": 1.0}
    return replace(grid, fault=(Fault(what, kind, **given),))


def of_one(landing: Landing) -> dict[str, Any]:
    """Return campaign row, mean absolute values of the true states, and event texts of a landing."""
    row, truth = row_of(landing), landing.seen.truth
    means = {name: rounded(np.abs(np.asarray(getattr(truth, name), float)).mean(axis=0)) for name in COLUMNS}
    found = {name: getattr(row, name) for name in row.__slots__ if name not in OMITTED}
    known = {name: value for name, value in found.items() if value not in (None, "")}
    return known | means | {"texts": [event.text for event in landing.seen.events]}


def rounded(values: Any) -> Any:
    return [float(f"{each:.8g}") for each in np.atleast_1d(values)]


def of_several(flown: Landing) -> dict[str, Any]:
    pairs = [[pair.distance_min_m, pair.ellipsoid_min] for pair in flown.pairs]
    alone = [replace(each, pairs=(), others=()) for each in flown.members]
    return {
        "members": [of_one(each) for each in alone],
        "pairs": pairs,
        "waits_s": [each.wait_s for each in flown.members],
    }


def _cases() -> dict[str, Callable[[], dict[str, Any]]]:
    def one(make: Callable[[], Scenario], seed: int = 1) -> Callable[[], dict[str, Any]]:
        return lambda: of_one(land(make(), seed))

    cases = {name: one(lambda name=name: fs.scenario(name)) for name in names() if not load(name).others}
    for tier in TIERS:
        for kind in ("robust", "paper"):
            for seed in (2, 3):
                flown = lambda tier=tier, kind=kind: fs.scenario(tier, filter=kind)  # noqa: E731
                cases[f"{tier}, {kind}, {seed}"] = one(flown, seed)
    for name, (base, keys) in VARIANTS.items():
        cases[f"{base}, {name}"] = one(lambda base=base, keys=keys: fs.scenario(base, keys))
    for what, kinds in TABLE.items():
        for kind in kinds:
            cases[f"{what.value}, {kind.value}"] = one(lambda what=what, kind=kind: faulty(what, kind))
    for what, kind in IN_TAKEOFF:
        made = lambda what=what, kind=kind: faulty(what, kind, in_takeoff=True)  # noqa: E731
        cases[f"take-off, {what.value}, {kind.value}"] = one(made)
    return cases | {"fleet_3": lambda: of_several(land(load("fleet_3"), 1))}


CASES = _cases()


def differences(stored: Any, found: Any, place: str = "") -> list[str]:
    """Return the differences of two results; the tolerance covers the rounding of other processors."""
    if isinstance(stored, dict) and isinstance(found, dict):
        keys = sorted(stored.keys() | found.keys())
        return [
            text for key in keys for text in differences(stored.get(key), found.get(key), f"{place}.{key}")
        ]
    if isinstance(stored, list) and isinstance(found, list) and len(stored) == len(found):
        pairs = enumerate(zip(stored, found, strict=True))
        return [text for n, (a, b) in pairs for text in differences(a, b, f"{place}[{n}]")]
    if isinstance(stored, float) and isinstance(found, int | float):
        near = math.isclose(stored, found, rel_tol=1e-5, abs_tol=1e-6)
        both_nan = stored != stored and found != found
        return [] if near or both_nan else [f"{place}: stored {stored}, now {found}"]
    return [] if stored == found else [f"{place}: stored {stored!r}, now {found!r}"]


if __name__ == "__main__":
    stored = json.loads(FILE.read_text()) | {name: CASES[name]() for name in sys.argv[1:] or CASES}
    lines = [f"{json.dumps(name)}: {json.dumps(stored[name])}" for name in CASES]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    print(f"{FILE}: {len(CASES)} landings, {FILE.stat().st_size / 1024:.0f} KB")
