"""What the paper's filter does in a step, in compiled code; each function is that of ``PaperFilter``."""

from __future__ import annotations

from flightstack.compiled.jit import jitted
from flightstack.core.numeric import twin
from flightstack.core.safety import position_loop
from flightstack.core.safety.barrier import barrier_h
from flightstack.core.types import Vec3
from sim.runners.stretch.records import MindRecord, RulesRecord
from sim.runners.stretch.tuples import keep, three

_barrier_h, _nominal = twin(barrier_h, jitted), twin(position_loop.nominal_velocity, jitted)


@jitted
def target(p: RulesRecord, m: MindRecord, now_s: float) -> tuple[Vec3, Vec3, float, float]:
    """``TargetTrack.at``; nothing is known of its error."""
    m.target_age_s = age_s = max(0.0, now_s - m.sample_source_s - m.offset_s)
    ahead_s = min(age_s, p.target_age_max_s)
    (x, y, z), (vx, vy, vz) = three(m.sample_position), three(m.sample_velocity)
    return (x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s), (vx, vy, vz), 0.0, 0.0


@jitted
def approach(p: RulesRecord, e: Vec3, target_m_s: Vec3) -> Vec3:
    """Position loop with the target's velocity fed forward."""
    wanted: Vec3 = _nominal(e, three(p.gain_contact_1_s), target_m_s)
    return wanted


@jitted
def may_touch(p: RulesRecord, e: Vec3, d_m: float) -> bool:
    """Below the touchdown height in the descending cone."""
    low = bool(e[2] < p.touch_height_m and d_m <= p.pad_radius_m)
    return low and _barrier_h(p.alpha_1_m, p.beta_m, e) >= 0.0


@jitted
def setpoint(m: MindRecord, wanted: Vec3) -> Vec3:
    """The velocity wanted; kept, as it is sent."""
    keep(m.setpoint, wanted)
    return wanted
