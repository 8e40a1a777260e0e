"""The MuJoCo model as XML text: floor, ground robot with pad, vehicle, and sensors of what touches what.

The robot is a body on three slides and a hinge, so that it has a velocity and friction carries what stands on
it (a mocap body has none). Its state is imposed every step; it weighs so much that no contact moves it in
between. The friction cone is elliptic: the pyramid would hold diagonally with 0.7 of the friction only.
Gravity is off and the vehicle's weight is applied as a force, so that the robot needs no support.
"""

from __future__ import annotations

import math

from sim.plant.params import STEP_S, Params
from sim.scenarios.scenario import TargetSpec
from sim.world.contact import PAD_CONTACTS

HEAVY_KG = 1.0e4  # against 0.03 kg: a landing moves it by nothing
QPOS, QVEL = 11, 10  # the vehicle's free joint comes first, then the robot's x, y, z and yaw


def vehicle_geoms(params: Params) -> str:
    """Feet, board and propeller discs; feet first."""
    g, r = params.geometry, params.rotor
    z = g.foot_bottom_m + g.foot_radius_m
    feet, discs = [], []
    for sx, sy in ((1, -1), (-1, -1), (-1, 1), (1, 1)):  # M1..M4
        x, y = sx * g.foot_offset_m, sy * g.foot_offset_m
        feet.append(f'<geom class="vehicle" type="sphere" size="{g.foot_radius_m}" pos="{x} {y} {z}"/>')
        x, y = sx * r.arm_m, sy * r.arm_m
        size = f"{r.radius_m} {g.propeller_half_thickness_m}"
        discs.append(f'<geom class="vehicle" type="cylinder" size="{size}" pos="{x} {y} {r.above_com_m}"/>')
    half = " ".join(map(str, g.body_half_size_m))
    board = f'<geom class="vehicle" type="box" size="{half}" pos="0 0 {g.body_centre_z_m}"/>'
    return "\n".join([*feet, board, *discs])


def robot_geoms(params: Params, target: TargetSpec) -> str:
    """Pad, and body and lidar of the robot below it; origin is the pad centre (top), x forward.

    A pad lower than the robot is tall (a deck of another kind) has only a box below it.
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


def model_xml(params: Params, mass_kg: float, target: TargetSpec) -> str:
    """Return the whole model. Joints: the vehicle's free joint, then the robot's x, y, z and yaw."""
    jxx, jyy, jzz = params.body.inertia_kg_m2
    scale = mass_kg / params.body.mass_kg
    inertia = f"{jxx * scale} {jyy * scale} {jzz * scale}"
    c = params.contact
    if not math.isfinite(scale) or scale <= 0.0:
        raise ValueError(f"mass_kg: found {mass_kg}, a positive number is needed")
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
      <inertial pos="0 0 0" mass="{mass_kg}" diaginertia="{inertia}"/>
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
