"""The baseline of fleets: one central program for all vehicles, after arXiv 2504.05939.

Sankaranarayanan, Saradagi, Satpute and Nikolakopoulos, "Collision-free landing of multiple UAVs on moving
ground vehicles using time-varying control barrier functions". Read of it: the abstract, the introduction, and
a public review of the rest (themoonlight.io). So these are the paper's: all velocities in one quadratic
program with a box, the time-varying landing barrier of each pair, |p_i - p_j|^2 >= (s_i + s_j)^2 for each two
vehicles, the nominal velocity K_p (p_d - p) + v_d. Assumptions: s_i, the rate of both barriers (0.7 1/s, that
of the first paper's landing barrier), K_p = 1, the slew limit, and the scenario.

It knows all states as they are measured, at once: no words, no right of way, no shares. It answers one
tick later, as words do, and each vehicle then holds its landing barrier once more by its newest state. Who
has landed has no row any more, and who flies a touchdown unfiltered is a neighbour that goes straight on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import osqp
from scipy import sparse

from flightstack.core.controller import Outputs
from flightstack.core.fleet.exact import Row
from flightstack.core.safety.barrier import ActiveBarrier
from flightstack.core.safety.position_loop import clip_to_box
from flightstack.core.safety.projection import best_corner
from flightstack.core.safety.qp_filter import FilterResult, Program, SafetyFilter
from flightstack.core.snapshot import Snapshot
from flightstack.core.strategies.paper import PaperFilter
from flightstack.core.types import ZERO, FilterStatus, Neighbour, Phase, Vec3
from sim.scenarios.team import TeamScenario

FILTER = "tests.benchmarks.central:CentralFilter"
CENTRAL_ID = 250  # of its words
RATE_1_S = 0.7  # assumption: that of the landing barrier
RESIDUAL_MAX_M_S = 1e-4  # of a row or a side of the box
SLACK_COST_M_S = 20.0  # above the sum of the multipliers of speeds around 1 m/s
_DOWN = (Phase.LANDED,)


class CentralFilter(PaperFilter):
    """The paper's filter, fed with the velocity that the central program found for this vehicle."""

    _told: Vec3 | None = None

    def barrier(self, snapshot: Snapshot) -> ActiveBarrier:
        """The paper's; keeps the newest word of the central program."""
        words = [word for word in snapshot.inputs.neighbours if word.id == CENTRAL_ID]
        self._told = words[-1].wanted_enu_m_s if words else None
        return super().barrier(snapshot)

    def program(self) -> Program:
        """Eq. 11 about the velocity told."""
        return _Told(self, SafetyFilter(self.rate_1_s))


class _Told:
    def __init__(self, strategy: CentralFilter, program: SafetyFilter) -> None:
        self._strategy, self._program = strategy, program

    def solve(
        self, nominal: Vec3, h_m: float, gradient: Vec3, dh_dt_m_s: float, lower: Vec3, upper: Vec3
    ) -> FilterResult:
        """Filter what was told, or the nominal velocity before anything was."""
        told = self._strategy._told
        wanted = nominal if told is None else told
        return self._program.solve(wanted, h_m, gradient, dh_dt_m_s, lower, upper)


class One(NamedTuple):
    """A vehicle as the program sees it.

    Attributes:
        nominal: velocity, m/s.
        landing: row of its landing barrier; ``None``: the program does not decide about its velocity.
        lower: lower corner of its box, m/s.
        upper: upper corner, m/s.
        position_enu_m: measured.
    """

    nominal: Vec3
    landing: Row | None
    lower: Vec3
    upper: Vec3
    position_enu_m: Vec3


class JointProgram:
    """All velocities of some vehicles in one program.

    min sum |u_i - u_i'|^2 with a box and a landing row for each vehicle and a row for each two, divided by
    twice their distance, so that it is in m/s. The last variable is a slack of the rows of two, 0 unless
    nothing meets them all.

    Attributes:
        relaxed: times that the rows of two had to give way.
        unsolved: times that the solver failed even so: the result is the nominal velocities in their boxes,
            and only the landing barriers are held, by the vehicles.

    Args:
        number: of vehicles.
        distance_m: s_i + s_j.
    """

    def __init__(self, number: int, distance_m: float) -> None:
        self.relaxed = self.unsolved = 0
        self._distance_m, self._pairs = distance_m, list(combinations(range(number), 2))
        size, pairs = 3 * number, len(self._pairs)
        self._a = np.zeros((number + pairs + size + 1, size + 1))
        pattern = np.zeros_like(self._a)
        for i in range(number):
            pattern[i, 3 * i : 3 * i + 3] = 1.0
        for k, (i, j) in enumerate(self._pairs, number):
            pattern[k, 3 * i : 3 * i + 3] = pattern[k, 3 * j : 3 * j + 3] = pattern[k, size] = 1.0
        pattern[number + pairs :, :] = np.eye(size + 1)
        self._a[:] = pattern
        self._at = np.nonzero(pattern.T)  # column-wise, as OSQP keeps it
        self._low, self._high = np.full(len(pattern), -np.inf), np.full(len(pattern), np.inf)
        hessian = sparse.diags([1.0] * size + [1e-3], format="csc")
        self._solver = osqp.OSQP()
        self._solver.setup(
            hessian, np.zeros(size + 1), sparse.csc_matrix(pattern), self._low, self._high, verbose=False,
            eps_abs=1e-7, eps_rel=0.0, max_iter=4_000, polishing=True, scaling=10, rho=1.0, adaptive_rho=1,
            adaptive_rho_interval=50, check_termination=10, warm_starting=False,
        )  # fmt: skip

    def solve(self, every: Sequence[One]) -> list[Vec3]:
        """Velocities of all, in order; those that it does not decide about are given back.

        Args:
            every: as many as the program was made for.
        """
        number, a, low, high = len(every), self._a, self._low, self._high
        size, box = 3 * number, len(a) - 3 * number - 1
        first = []
        for i, one in enumerate(every):
            sides = slice(box + 3 * i, box + 3 * i + 3)
            first.append(clip_to_box(one.nominal, one.lower, one.upper))
            if one.landing is None:  # flies by itself, and goes on so
                low[sides] = high[sides] = first[i] = one.nominal
                a[i, 3 * i : 3 * i + 3], low[i] = 0.0, -np.inf
                continue
            low[sides], high[sides] = one.lower, one.upper
            reached = one.landing.missing_m_s(best_corner(one.landing.g, one.lower, one.upper))
            a[i, 3 * i : 3 * i + 3] = one.landing.g
            low[i] = one.landing.bound_m_s - max(0.0, reached)  # as near as the box comes to it
        for k, (i, j) in enumerate(self._pairs, number):
            away = np.subtract(every[i].position_enu_m, every[j].position_enu_m)
            far_m = max(float(np.linalg.norm(away)), 1e-3)
            n = away / far_m
            a[k, 3 * i : 3 * i + 3], a[k, 3 * j : 3 * j + 3] = n, -n
            low[k] = -RATE_1_S * (far_m * far_m - self._distance_m * self._distance_m) / (2.0 * far_m)
            if every[i].landing is None and every[j].landing is None:
                low[k] = -np.inf
        start = np.array([*np.concatenate(first), 0.0])
        if (a[:box] @ start >= low[:box]).all():
            return first
        for cost, most in ((0.0, 0.0), (SLACK_COST_M_S, np.inf)):
            low[-1], high[-1] = 0.0, most
            q = np.array([*(-each for one in every for each in one.nominal), cost])
            self._solver.update(q=q, l=low, u=high, Ax=a.T[self._at])
            self._solver.warm_start(x=start, y=np.zeros(len(a)))
            found = self._solver.solve(raise_error=False)
            if self._good(found.x):
                self.relaxed += most > 0.0
                points = found.x[:size].reshape(-1, 3).tolist()
                return [
                    clip_to_box((x, y, z), *_sides(one)) for (x, y, z), one in zip(points, every, strict=True)
                ]
        self.unsolved += 1
        return first

    def _good(self, x: np.ndarray | None) -> bool:
        if x is None or not np.isfinite(x).all():
            return False
        rows = self._a @ x
        return bool(max((self._low - rows).max(), (rows - self._high).max()) <= RESIDUAL_MAX_M_S)


def _sides(one: One) -> tuple[Vec3, Vec3]:
    return (one.lower, one.upper) if one.landing is not None else (one.nominal, one.nominal)


class Central:
    """The exchange of ``land_team``: takes the outputs of all, and tells each vehicle its velocity.

    Attributes:
        programs: by the number of vehicles that are in the air.

    Args:
        team: whose members fly ``CentralFilter``, without a table [fleet].
        distance_m: s_i + s_j.
    """

    def __init__(self, team: TeamScenario, distance_m: float) -> None:
        self._members, self._distance_m = [each.onboard for each in team.member], distance_m
        self.programs: dict[int, JointProgram] = {}

    def __call__(self, tick: int, outputs: Sequence[Outputs | None]) -> list[tuple[Neighbour, ...]]:
        """Solve the program of a tick; who is down, or of whom nothing is known, has no part in it."""
        del tick
        seen = [self._one(number, out) for number, out in enumerate(outputs)]
        flying = [number for number, one in enumerate(seen) if one is not None]
        told: list[tuple[Neighbour, ...]] = [()] * len(outputs)
        every = [one for one in seen if one is not None]
        if not any(one.landing is not None for one in every):
            return told
        if len(every) not in self.programs:
            self.programs[len(every)] = JointProgram(len(every), self._distance_m)
        program = self.programs[len(every)]
        for number, velocity in zip(flying, program.solve(every), strict=True):
            told[number] = (Neighbour(CENTRAL_ID, 0.0, 0.0, ZERO, ZERO, velocity),)
        return told

    def _one(self, number: int, out: Outputs | None) -> One | None:
        if out is None or out.snapshot.inputs.own is None or out.phase in _DOWN:
            return None
        own, barrier, config = out.snapshot.inputs.own, out.barrier, self._members[number]
        if barrier is None or out.wanted is None or barrier.result.status is FilterStatus.NOT_RUN:
            return One(own.velocity_enu_m_s, None, ZERO, ZERO, own.position_enu_m)
        bound = -config.barrier.omega_1_s * barrier.h_m - barrier.dh_dt_m_s
        most, step = (
            config.limits.velocity_max_m_s,
            [a / config.loop.rate_hz for a in config.limits.slew_max_m_s2],
        )
        lower = tuple(max(-m, w - s) for m, w, s in zip(most, out.wanted, step, strict=True))
        upper = tuple(min(m, w + s) for m, w, s in zip(most, out.wanted, step, strict=True))
        return One(barrier.nominal, Row(barrier.gradient, bound), lower, upper, own.position_enu_m)


def central_team(team: TeamScenario) -> TeamScenario:
    """The same team for the central program."""
    members = [
        replace(each, onboard=replace(each.onboard, filter=FILTER, fleet=None)) for each in team.member
    ]
    return replace(team, member=tuple(members))
