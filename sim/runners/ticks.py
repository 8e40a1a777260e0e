"""Computes ticks of a landing in one call: deck, telemetry, controller, set-point, physics, true states.

A tick has the same effect as a tick of ``LockstepVehicle``. Python runs a whole tick if the landing kernel or
the telemetry requires it. Python runs the second part of a tick, after the controller's answer and the
radio's delay, if the autopilot has to do more than forward the set-point.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from bridge import frames
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64, Cell, Record, Vector, copy
from flightstack.compiled.tick import take
from flightstack.core.controller import Controller, Landing
from flightstack.core.numeric import NotOrdinary, twin
from flightstack.core.types import OwnState, Vec3
from sim.autopilot.flight import WatchRecord, check
from sim.clock import NS_PER_S
from sim.firmware.estimator import INNOVATION_AGE_MAX_S
from sim.firmware.setpoint import ROOM, WIDTH, InboxRecord
from sim.plant.rotors import speed_limit
from sim.vehicle.judge import GAP_MS
from sim.vehicle.physics import VehicleRecord, fly, write_truth
from sim.world.bodies import arc_of_step


class BatchRecord(Record):
    """Plan, constants and results of a batch of ticks; times are on the controller's clock."""

    # first tick, number of ticks to fly, number of target samples before the first tick; the last element
    # receives the number of ticks flown, including a tick whose second part is missing
    plan: Annotated[I64, 4]
    rate_hz: int
    radio_ms: int  # delay of set-points by the radio, ms
    # whether the controller sends set-points to an armed vehicle in the air; if not, the vehicle stands still
    flies: bool
    status_s: float  # arrival time of the newest heartbeat
    ends_s: float  # time limit of the flight
    # inputs of the vehicle's autopilot
    yaw_rad: float  # commanded heading, as the autopilot received it, rad
    cos_yaw: float
    sin_yaw: float
    speeds: Vector  # speed limits of the autopilot, m/s: horizontal, up, down
    supervisor: int  # state of the firmware's supervisor
    stream_until_s: float  # time at which the autopilot stops waiting for set-points
    # results
    own_sent: Annotated[F64, 8]  # newest state as sent: boot time, s; position, m; velocity, m/s; yaw, rad
    setpoint: Vector  # newest set-point, as the autopilot received it


@jitted
def _watch(watches: Cell[WatchRecord], v: VehicleRecord, now_s: float) -> None:
    """Compiled form of ``Watches.step``."""
    if now_s < watches[0].due_s:
        return
    limit, total = speed_limit(v.battery), 0.0
    for command in v.firmware.commands:
        total += min(1.0, max(0.0, command / limit))
    check(watches, now_s, v.battery.voltage_v, total / 4.0)


# how a call ends: END: all ticks are done; BEFORE: Python runs the next tick; MIDDLE: Python completes the
# last counted tick
END, BEFORE, MIDDLE = 0, 1, 2
_LARGEST = 1e6  # maximum accepted number, m, m/s or rad/s (bridge.mavlink.client.vehicle_state)
_POLE = 0.999  # sine of the pitch above which the nose is nearly vertical, and Python runs the tick


_frd, _euler = twin(frames.ned_frd_from_enu_flu, jitted), twin(frames.euler_from_quaternion, jitted)
_yaw_enu = twin(frames.yaw_enu_from_ned, jitted)


@jitted
def three(v: F64) -> Vec3:
    """Return an array of three numbers as a tuple."""
    return (v[0], v[1], v[2])


@jitted
def narrow(x: float) -> float:
    """Round a double to a 32-bit float, as in a message."""
    return float(np.float64(np.float32(x)))  # numba's float() would keep 32 bits


@jitted
def _narrow3(v: Vec3) -> Vec3:
    return (narrow(v[0]), narrow(v[1]), narrow(v[2]))


@jitted
def _usable(v: Vec3) -> bool:
    return abs(v[0]) < _LARGEST and abs(v[1]) < _LARGEST and abs(v[2]) < _LARGEST


@jitted
def _place_deck(v: VehicleRecord, deck: F64) -> None:
    """Compiled form of ``World.set_deck``."""
    d = v.world.deck
    for i in range(3):
        d.position[i], d.velocity[i] = deck[i], deck[4 + i]
    d.yaw, d.rate = deck[3], deck[7]
    d.cos_turn, d.sin_turn, d.along, d.across = arc_of_step(d.rate)


@jitted
def _send(p: BatchRecord, inbox: InboxRecord, setpoint: Vec3, now_ms: int) -> None:
    """Compiled form of ``VehicleSim.set_velocity``; a set-point takes effect after the radio's delay."""
    at = WIDTH * (inbox.end % ROOM)
    row = inbox.rows[at : at + WIDTH]
    row[:] = 0.0
    row[0], row[4], row[6], row[7] = now_ms + p.radio_ms, p.yaw_rad, p.cos_yaw, p.sin_yaw
    row[1], row[2], row[3] = setpoint[0], setpoint[1], setpoint[2]
    inbox.end += 1


@jitted
def _flyable(p: BatchRecord, v: Vec3) -> bool:
    """Whether the autopilot forwards this velocity unchanged."""
    xy, up, down = p.speeds[0], p.speeds[1], p.speeds[2]
    return bool(v[0] * v[0] + v[1] * v[1] <= xy * xy and -down <= v[2] <= up)


@jitted
def _needs_autopilot(p: BatchRecord, v: VehicleRecord, now_ms: int, now_s: float) -> bool:
    """Whether the autopilot has to do more than forward the set-point."""
    c, f = v.contact, v.firmware
    touches = now_ms - c.pad_ms <= GAP_MS or now_ms - c.ground_ms <= GAP_MS
    return (
        bool(f.supervisor.motors_allowed) != bool(p.flies)
        or touches == bool(p.flies)
        or not f.estimator.since_sample_s < INNOVATION_AGE_MAX_S
        or now_s > p.stream_until_s
    )


@jitted
def decided(
    v: VehicleRecord, p: BatchRecord, kernel: Controller, samples: F64, now_s: float
) -> tuple[OwnState, Landing]:
    """Pass the vehicle state and the ``samples`` of this tick to the controller; run its step."""
    f, e = v.firmware, v.firmware.estimator
    if (
        bool(f.supervisor.motors_allowed) != bool(p.flies)
        or f.supervisor.state != p.supervisor
        or f.inbox.end - f.inbox.first >= ROOM
        or not e.since_sample_s < INNOVATION_AGE_MAX_S
        or now_s - p.status_s > kernel.config.checks.status_age_max_s
        or now_s >= p.ends_s
    ):
        raise NotOrdinary
    position, velocity = _narrow3(three(e.sensed.position)), _narrow3(three(e.sensed.velocity))
    q = e.sensed.quaternion
    attitude = _frd((q[0], q[1], q[2], q[3]))
    if not (_usable(position) and _usable(velocity) and _usable(three(e.sensed.rates))):
        raise NotOrdinary
    if not abs(2.0 * (attitude[0] * attitude[2] - attitude[3] * attitude[1])) < _POLE:
        raise NotOrdinary
    source_s, yaw_rad = round(now_s * 1000) * 1e-3, _yaw_enu(narrow(_euler(attitude)[2]))
    kernel.track.memory.settled = True  # ``step`` also sets this flag from the take-off on
    for row in samples:
        take(kernel, row, now_s)
    own = OwnState(now_s, source_s, position, velocity, yaw_rad)
    return own, kernel.land(own, now_s)


@jitted
def fly_ticks(
    vehicle: Cell[VehicleRecord],
    batch: Cell[BatchRecord],
    watches: Cell[WatchRecord],
    kernel: Controller,
    state: F64,
    spare: F64,
    decks: F64,
    samples: F64,
    come: I64,
    truths: F64,
    ages: F64,
) -> int:
    """Fly ticks until all are done or Python is needed.

    ``watches``: state of the autopilot's ``Watches``; ``kernel``: the controller, whose state is changed in
    place; ``state``: memory of the controller's state; ``spare``: buffer that receives the state before
    the newest tick; ``decks``: (n, 8) for each tick: position, yaw, velocity, yaw rate of the pad;
    ``samples``: (m, 9) target samples: time stamp, position, velocity, yaw, yaw rate; ``come``: (n,) number
    of samples that arrive up to each tick; ``truths``: (n, TRUTH), receives true states; ``ages``: (n,),
    receives ages of the target state, s.

    Returns how the call ended: ``END``, ``BEFORE`` or ``MIDDLE``.
    Raises NotOrdinary: Python has to run the next tick, with the state in ``spare``.
    """
    v, p = vehicle[0], batch[0]
    rate, before, plan = p.rate_hz, p.plan[2], p.plan
    plan[3] = 0
    for n in range(plan[1]):
        copy(state, spare)
        tick = plan[0] + n
        now_s = tick * NS_PER_S // rate / 1e9
        now_ms, end_ms = (2000 * tick + rate) // (2 * rate), (2000 * (tick + 1) + rate) // (2 * rate)
        own, landing = decided(v, p, kernel, samples[before : come[n]], now_s)
        setpoint = _narrow3(landing.setpoint)
        if landing.sends != bool(p.flies) or (landing.sends and not _flyable(p, setpoint)):
            raise NotOrdinary
        before = come[n]
        ages[n] = landing.at.target.age_s
        for i in range(3):
            p.own_sent[1 + i], p.own_sent[4 + i] = own.position_enu_m[i], own.velocity_enu_m_s[i]
            p.setpoint[i] = setpoint[i]
        p.own_sent[0], p.own_sent[7] = own.source_time_s, own.yaw_rad
        plan[3] = n + 1
        _place_deck(v, decks[n])
        write_truth(vehicle, now_ms, truths[n])
        ahead_ms = min(end_ms - now_ms, p.radio_ms)
        fly(vehicle, now_ms, now_ms + ahead_ms)
        if _needs_autopilot(p, v, now_ms + ahead_ms, now_s):
            return MIDDLE
        _watch(watches, v, now_s)
        if landing.sends:
            _send(p, v.firmware.inbox, setpoint, now_ms)
        fly(vehicle, now_ms + ahead_ms, end_ms)
    return END
