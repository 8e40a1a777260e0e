"""Fleet of vehicles, each with its own controller, over a network that delays and loses messages."""

import heapq
import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from flightstack.core.controller import Controller
from flightstack.core.fleet.pair import barrier
from flightstack.core.types import (
    Inputs,
    Landed,
    Mode,
    OwnState,
    Phase,
    Request,
    TargetSample,
    VehicleStatus,
)
from tests.unit.core.core_helpers import config

RATE_HZ = 50
DT_S = 1.0 / RATE_HZ
LOOP_RATE_1_S, DAMPING = 5.2, 0.68  # velocity loop of second order
FEET_M = 0.0144
MEMBERS = (3, 7)


def fleet(members=MEMBERS, **keys):
    """Return the table [fleet] of the first member."""
    return {"id": members[0], "members": list(members), **keys}


def settings_of(id_, members, fleet_keys=None, **sections):
    """Return the configuration of one member."""
    table = {**fleet(members), **(fleet_keys or {}), "id": id_}
    limits = {"velocity_max_m_s": [0.5, 0.5, 0.5], "altitude_max_m": 6.0}
    return config(loop={"rate_hz": RATE_HZ}, limits=limits, fleet=table, **sections)


def parked(x, y, z=0.2):
    """Return a pad that does not move."""
    return lambda _: ((x, y, z), (0.0, 0.0, 0.0))


def driving(x, y, vx, vy, z=0.2):
    """Return a pad that drives straight."""
    return lambda t: ((x + vx * t, y + vy * t, z), (vx, vy, 0.0))


@dataclass
class Flyer:
    """One vehicle above its pad."""

    config: object
    position: tuple
    pad: object
    velocity: tuple = (0.0, 0.0, 0.0)
    change: tuple = (0.0, 0.0, 0.0)
    armed: bool = True
    mode: Mode = Mode.HOLD
    landed: Landed = Landed.IN_AIR
    touched_s: float = math.inf
    carried_to: tuple | None = None  # velocity at which the operator carries it away
    silent_from_s: float = math.inf
    arms_again: bool = True  # False: it rejects further arming
    refused: bool = False
    texts: list = field(default_factory=list)
    phases: list = field(default_factory=list)
    statuses: list = field(default_factory=list)
    word: object = None

    def __post_init__(self):
        self.controller = Controller(self.config)
        self.id = self.config.fleet.id

    @property
    def phase(self):
        return self.controller.memory.phase

    @property
    def on_pad(self):
        return self.touched_s < math.inf and not self.armed

    def step(self, t_s, words):
        """Run one tick; ``word`` is then its message to the others."""
        pad, speed = self.pad(t_s)
        own = OwnState(t_s, t_s, self.position, self.velocity, 0.0)
        status = VehicleStatus(t_s, self.armed, self.mode, self.landed, True)
        sample = TargetSample(t_s, t_s + 7.0, "map", "target", pad, speed, 0.0, 0.0)
        inputs = Inputs(own, status, (sample,), neighbours=tuple(words))
        failed = {"command_failed": True} if self.refused else {}
        out = self.controller.step(inputs, t_s, **failed)
        self.texts += [event.text for event in out.events]
        if not self.phases or self.phases[-1] is not out.phase:
            self.phases.append(out.phase)
        if out.barrier is not None:
            self.statuses.append(out.barrier.result.status)
        self.word = out.own_word if t_s < self.silent_from_s else None
        self._fly(out, t_s)
        return out

    def _fly(self, out, t_s):
        if out.request is Request.TAKEOFF and not self.armed:  # the take-off is flown by set-points
            self.refused = not self.arms_again
            self.armed, self.mode, self.touched_s = self.arms_again, Mode.EXTERNAL, math.inf
        if out.request is Request.MOTORS_OFF:
            self.armed = False
        elif out.request is Request.LAND:
            self.mode = Mode.LAND
        elif out.request is Request.EXTERNAL and out.setpoint is not None and self.mode is Mode.HOLD:
            self.mode = Mode.EXTERNAL
        wanted = np.zeros(3)
        if self.mode is Mode.EXTERNAL and out.setpoint is not None:
            wanted = np.array(out.setpoint.velocity_enu_m_s)
        elif self.mode is Mode.LAND:
            wanted = np.array((0.0, 0.0, -0.3))
        p, v, a = np.array(self.position), np.array(self.velocity), np.array(self.change)
        for _ in range(2):
            a += 0.5 * DT_S * (LOOP_RATE_1_S**2 * (wanted - v) - 2.0 * DAMPING * LOOP_RATE_1_S * a)
            v += 0.5 * DT_S * a
            p += 0.5 * DT_S * v
        pad, speed = self.pad(t_s + DT_S)
        over = math.dist(p[:2], pad[:2]) < 0.1
        if not self.armed or (over and p[2] <= pad[2] + FEET_M):
            if over and p[2] <= pad[2] + FEET_M + 0.02:
                p[2], v, self.touched_s = pad[2] + FEET_M, np.array(speed), min(self.touched_s, t_s)
                a = np.zeros(3)
            if t_s - self.touched_s > 0.3:
                self.landed = Landed.ON_GROUND
        elif p[2] > 0.015:
            self.landed = Landed.IN_AIR
        if p[2] <= 0.015:
            p[2], v, a, self.landed = 0.015, np.zeros(3), np.zeros(3), Landed.ON_GROUND
            self.armed = self.armed and self.mode is not Mode.LAND
        if self.carried_to is not None:
            p, v = p + DT_S * np.array(self.carried_to), np.array(self.carried_to)
        self.position, self.velocity, self.change = tuple(p.tolist()), tuple(v.tolist()), tuple(a.tolist())


class Sky:
    """All vehicles, and the network between them.

    Args:
        flyers: vehicles in any order.
        delay_s: smallest and largest delay of a message.
        lost: share of lost messages.
        seed: seed of delays and losses.
    """

    def __init__(self, flyers, delay_s=(0.02, 0.1), lost=0.1, seed=0):
        self.flyers, self.delay_s, self.lost = flyers, delay_s, lost
        self.t_s, self.least_h_m, self.least_at = 0.0, math.inf, None
        self._rng, self._count = np.random.default_rng(seed), itertools.count()
        self._under_way = {f.id: [] for f in flyers}

    def step(self):
        for flyer in self.flyers:
            queue, words = self._under_way[flyer.id], []
            while queue and queue[0][0] <= self.t_s + 1e-9:
                words.append(heapq.heappop(queue)[2]._replace(arrival_s=self.t_s))
            flyer.step(self.t_s, words)
        for flyer in self.flyers:
            for other in self.flyers:
                if flyer.word is None or other is flyer or self._rng.random() < self.lost:
                    continue
                at_s = self.t_s + self._rng.uniform(*self.delay_s)
                heapq.heappush(self._under_way[other.id], (at_s, next(self._count), flyer.word))
        self.t_s = round(self.t_s + DT_S, 6)
        for a, b in itertools.combinations(self.flyers, 2):
            self._measure(a, b)

    def _measure(self, a, b):
        table = a.config.fleet
        away = tuple(p - q for p, q in zip(a.position, b.position, strict=True))
        h_m, _ = barrier(away, table.radius_xy_m, table.radius_z_m)
        if h_m < self.least_h_m:
            self.least_h_m, self.least_at = h_m, (round(self.t_s, 2), a.id, a.phase.name, b.id, b.phase.name)

    def run(self, seconds, until=None):
        """Step until the time is over or ``until(self)`` holds."""
        end_s = self.t_s + seconds
        while self.t_s < end_s and not (until is not None and until(self)):
            self.step()
        return self


def all_landed(sky):
    return all(f.on_pad and f.phase is Phase.LANDED for f in sky.flyers)
