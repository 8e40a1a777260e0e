"""The MuJoCo model, and the record with the states of vehicle and moving deck."""

from __future__ import annotations

import ctypes
import math
from functools import cache, lru_cache
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from flightstack.compiled.records import cell, new, reader, writer
from flightstack.core.types import Vec3
from sim.plant.params import STEP_S, Params
from sim.plant.states import Body
from sim.scenarios.tables import TargetSpec
from sim.world.bodies import arc_of_step
from sim.world.step import PAD_CONTACTS, ReachRecord, WorldRecord, set_up_rest

MARGIN_M = 1e-3  # margin for rounding errors, m
_LIBRARIES = ("libmujoco*.so*", "libmujoco*.dylib", "mujoco.dll")  # file names on Linux, macOS, Windows
HEAVY_KG = 1.0e4  # mass of the simulated robot; no contact with the vehicle (0.03 kg) moves such a mass
QPOS, QVEL = 11, 10  # sizes of MuJoCo's state: the vehicle's free joint, then the robot's x, y, z and yaw


@cache
def mujoco_function(name: str) -> int:
    """Return the address of a function in MuJoCo's C library, which its Python package has loaded.

    Raises OSError: the package has no such library; AttributeError: the library has no such function.
    """
    folder = Path(mujoco.__file__).parent
    found = sorted(each for kind in _LIBRARIES for each in folder.glob(kind))
    if not found:
        raise OSError(f"{folder}: no C library of MuJoCo is there; install mujoco again")
    return ctypes.cast(getattr(ctypes.CDLL(str(found[0])), name), ctypes.c_void_p).value or 0


def measure_reach(model: mujoco.MjModel, reach: ReachRecord) -> None:
    """Compute the bounds ``reach``; ``model`` has bodies ``vehicle``, ``robot_body`` and a floor at z = 0."""
    roots = model.body_rootid[model.geom_bodyid]
    of_vehicle, of_robot = (roots == model.body(name).id for name in ("vehicle", "robot_body"))
    margin = MARGIN_M + model.geom_margin.max() + model.geom_gap.max()
    distances = np.linalg.norm(model.geom_pos[of_vehicle], axis=1)
    reach.vehicle = margin + (distances + model.geom_rbound[of_vehicle]).max()
    side, bottom, top = _cylinder(model, of_vehicle)
    reach.side, reach.bottom, reach.top = margin + side, bottom - margin, margin + top
    side, _, top = _cylinder(model, of_robot)
    reach.robot, reach.robot_top = margin + side, margin + top


def _cylinder(model: mujoco.MjModel, geoms: npt.NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return radius, bottom and top of a cylinder about body z around geoms aligned with the body."""
    centre = model.geom_pos[geoms] + model.geom_aabb[geoms, :3]
    half = model.geom_aabb[geoms, 3:]
    return (
        np.hypot(*(np.abs(centre) + half)[:, :2].T).max(),
        (centre - half)[:, 2].min(),
        (centre + half)[:, 2].max(),
    )


class World:
    """The vehicle's rigid body and the deck.

    ``params``: geometry and contact; ``mass_kg``: true mass; the inertia scales with the mass; ``target``:
    shapes of pad and robot; ``record``: record that stores the state; None creates one.
    """

    def __init__(
        self, params: Params, mass_kg: float, target: TargetSpec, record: WorldRecord | None = None
    ) -> None:
        self._model = model = compiled_model(params, mass_kg, target)
        self._data = data = mujoco.MjData(model)
        self.record = r = new(WorldRecord) if record is None else record  # state of vehicle and deck
        measure_reach(model, r.reach)
        r.wrench.mass, r.wrench.inertia[:] = mass_kg, model.body("vehicle").inertia
        set_up_rest(r.rest, params, target.pad_radius_m)
        self._read_body, self._set_body = reader(r.body), writer(r.body)
        self._read_deck, self._set_deck = reader(r.deck), writer(r.deck)
        cell(r.mujoco)[0] = (
            mujoco_function("mj_step"),
            model._address,
            data._address,
            *(each.ctypes.data for each in (data.qpos, data.qvel, data.qfrc_applied, data.sensordata)),
        )
        self.set_vehicle((0.0, 0.0, 1.0))
        self.set_deck((*target.position_m, target.pad_height_m), 0.0, (0.0, 0.0, 0.0), 0.0)

    def set_vehicle(
        self,
        position: Vec3,
        quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
        velocity: Vec3 = (0.0, 0.0, 0.0),
        rates: Vec3 = (0.0, 0.0, 0.0),
    ) -> None:
        """Set position, velocity, attitude and rates of the vehicle."""
        self.record.rest.steps = 0
        self._set_body(*position, *velocity, *quaternion, *rates)

    def set_deck(self, position: Vec3, yaw: float, velocity: Vec3, rate: float) -> None:
        """Set the deck's state; the deck then moves on an arc with constant speed, climb and turn rate."""
        self._set_deck(*position, *velocity, yaw, rate, *arc_of_step(rate))

    def body(self) -> Body:
        """Return the motion of the vehicle."""
        b = self._read_body()
        return Body(b[:3], b[3:6], b[6:10], b[10:])

    @property
    def deck_pose(self) -> tuple[Vec3, float]:
        """Position of the pad centre (top side), ENU, m, and its heading, rad."""
        deck = self._read_deck()
        return deck[:3], deck[6]


def vehicle_geoms(params: Params) -> str:
    """Return the XML of feet, board and propeller discs; feet first."""
    g, r = params.geometry, params.rotor
    z = g.foot_bottom_m + g.foot_radius_m
    feet, discs = [], []
    for sx, sy in ((1, -1), (-1, -1), (-1, 1), (1, 1)):  # signs of x and y of M1 to M4
        x, y = sx * g.foot_offset_m, sy * g.foot_offset_m
        feet.append(f'<geom class="vehicle" type="sphere" size="{g.foot_radius_m}" pos="{x} {y} {z}"/>')
        x, y = sx * r.arm_m, sy * r.arm_m
        size = f"{r.radius_m} {g.propeller_half_thickness_m}"
        discs.append(f'<geom class="vehicle" type="cylinder" size="{size}" pos="{x} {y} {r.above_com_m}"/>')
    half = " ".join(map(str, g.body_half_size_m))
    board = f'<geom class="vehicle" type="box" size="{half}" pos="0 0 {g.body_centre_z_m}"/>'
    return "\n".join([*feet, board, *discs])


def robot_geoms(params: Params, target: TargetSpec) -> str:
    """Return the XML of the pad and of the robot below it; origin: pad centre (top side), x forward.

    A deck that is lower than the robot's height has only a box below the pad.
    """
    r = params.robot
    half = r.pad_thickness_m / 2.0
    pad = f'<geom name="pad" type="cylinder" size="{target.pad_radius_m} {half}" pos="0 0 {-half}"/>'
    below_pad = target.pad_height_m - target.heave_amplitude_m - r.pad_thickness_m
    top = min(r.body_height_m, below_pad)
    bottom = min(r.ground_clearance_m, 0.5 * top)
    x = target.pad_behind_axle_m - r.body_centre_behind_axle_m
    low = bottom - target.pad_height_m
    high = top - target.pad_height_m
    size = f"{r.body_length_m / 2.0} {r.body_width_m / 2.0} {(high - low) / 2.0}"
    below = f'<geom type="box" size="{size}" pos="{x} 0 {(high + low) / 2.0}"/>'
    lidar_top = min(r.lidar_top_m, below_pad)
    column_half = (lidar_top - top) / 2.0
    if column_half > 1e-3:
        z = (lidar_top + top) / 2.0 - target.pad_height_m
        below += f'<geom type="cylinder" size="{r.lidar_radius_m} {column_half}" pos="{x} 0 {z}"/>'
    return f'{pad}<body name="below_pad">{below}</body>'


def compiled_model(params: Params, mass_kg: float, target: TargetSpec) -> mujoco.MjModel:
    """Return the model of a vehicle with this mass; its inertia scales with the mass."""
    if not math.isfinite(mass_kg) or mass_kg <= 0.0:
        raise ValueError(f"mass_kg: found {mass_kg}, a positive number is needed")
    # a copy, because other threads may use the parsed model
    spec, scale = _parsed(model_xml(params, target)).copy(), mass_kg / params.body.mass_kg
    vehicle = spec.body("vehicle")
    vehicle.mass, vehicle.inertia = mass_kg, [each * scale for each in params.body.inertia_kg_m2]
    return spec.compile()


@lru_cache(maxsize=16)  # the vehicles of a campaign differ only in mass
def _parsed(xml: str) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(xml)


def model_xml(params: Params, target: TargetSpec) -> str:
    """Return the MuJoCo model as XML. Joints: free joint of the vehicle; x, y, z and yaw of the robot.

    The robot is a body with a velocity, because only a moving body carries others by friction (a mocap body
    has no velocity). The robot's state is set every step; in between, no contact moves such a large mass.
    The friction cone is elliptic: a pyramid has only 0.7 of the friction along the diagonals. Gravity is off
    and the vehicle's weight is applied as a force, so that the robot needs no support.
    """
    inertia, c = " ".join(map(str, params.body.inertia_kg_m2)), params.contact
    return f"""
<mujoco model="landing">
  <compiler autolimits="false"/>
  <option timestep="{STEP_S}" gravity="0 0 0" integrator="Euler" cone="elliptic" solver="Newton"
      iterations="30" tolerance="1e-10">
    <flag equality="disable" frictionloss="disable" limit="disable" clampctrl="disable" actuation="disable"
         eulerdamp="disable" island="disable" autoreset="disable"/>
  </option>
  <default>
    <geom contype="1" conaffinity="0" condim="3" friction="{c.friction} 0 0" solref="{c.time_constant_s} 1"
        solimp="0.9 0.98 0.0005"/>
    <default class="vehicle"><geom contype="0" conaffinity="1"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="vehicle">
      <freejoint/>
      <inertial pos="0 0 0" mass="{params.body.mass_kg}" diaginertia="{inertia}"/>
      {vehicle_geoms(params)}
    </body>
    <body name="robot_body">
      <inertial pos="0 0 0" mass="{HEAVY_KG}" diaginertia="{HEAVY_KG} {HEAVY_KG} {HEAVY_KG}"/>
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 1 0"/>
      <joint type="slide" axis="0 0 1"/>
      <joint type="hinge" axis="0 0 1"/>
      {robot_geoms(params, target)}
    </body>
  </worldbody>
  <sensor>
    <contact geom1="floor" body2="vehicle" data="found"/>
    <contact body1="below_pad" body2="vehicle" data="found"/>
    <contact geom1="pad" body2="vehicle" data="found pos normal" num="{PAD_CONTACTS}"/>
  </sensor>
</mujoco>
"""
