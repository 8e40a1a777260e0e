"""Gymnasium environment: the agent chooses the nominal velocity of the landing in each tick.

A flight has the simulator, autopilot, connections, phase machine, gate and verdict of ``fs.land``. The flight
runs in a greenlet that pauses when the stack requests the nominal velocity, and continues with the agent's
action.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from greenlet import greenlet
from gymnasium import spaces

from flightstack.api.landing import Changes, single, whole
from flightstack.common.strict_toml import ConfigError
from flightstack.core.controller import Controller
from flightstack.core.mission.phases import TIME_OVER
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.snapshot import Relative
from flightstack.core.types import ZERO, Vec3
from logs.reader.flight_data import Truth
from logs.verdict.truth import judge_truth
from logs.verdict.types import VIOLATION_LIMIT_M, Outcome
from sim.runners.landing import Companion, Flights, warm_up
from sim.scenarios.scenario import Scenario

# The cost of a tick is small compared with the reward for the approach; else an agent learns to crash early.
APPROACH_REWARD_1_M = 10.0  # reward for each metre by which the distance to the landing spot decreases
STEP_REWARD = -0.001  # reward for each tick
VIOLATION_REWARD = -0.1  # reward for each tick with h below -5 mm outside the pad
END_REWARD = {Outcome.LANDED: 10.0, Outcome.CRASHED: -10.0}  # reward at the end, by outcome
OTHER_END_REWARD = -5.0
_SPEED_FAR_M = 1e3  # limit of each observed value's magnitude, m or m/s

ENV_ID = "flightstack/Landing-v0"


class LandingEnv(gymnasium.Env[np.ndarray, np.ndarray]):  # type: ignore[misc]  # gymnasium is an extra
    """One landing; a step is a tick of the controller (0.01 s) in the phases APPROACH and LAND.

    The stack itself flies take-off, touchdown, go-arounds and aborts, between two steps or in the last step.

    Observation, (13,), SI, ENU: vehicle's position minus landing spot (3), vehicle's velocity minus landing
    spot's velocity (3), landing spot's velocity (3), value h of the paper's barrier (1), velocity command of
    the last tick (3); positions and h in m, velocities in m/s, from the estimated states.

    Action, (3,): nominal velocity of the vehicle, m/s ENU, within ``limits.velocity_max_m_s``. The stack
    limits the velocity and its rate of change and, with a ``filter``, enforces the barrier. The robust filter
    also limits the horizontal velocity relative to the target to ``robust.gain_1_s`` times the distance.

    Reward: 10 for each metre by which the distance to the landing spot decreases, -0.001 for each step, and
    -0.1 for each step with h below -5 mm outside the pad; at the end 10 for a landing, -10 for a crash, 0 at
    the time limit, and -5 otherwise.

    ``terminated``: the flight is over; ``truncated``: the flight exceeded its time limit. The last ``info``
    has ``verdict``, ``outcome``, ``violation`` (None: unknown), ``h_min_outside_pad_m`` and ``is_success``.

    Args:
        scenario: name, file or object of a scenario of one vehicle.
        filter: ``"paper"`` or ``"robust"``; None: no safety filter.
        changes: keys of the scenario to change, see ``fs.scenario``.

    Raises:
        ConfigError: a scenario, key or filter is wrong.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self, scenario: str | Path | Scenario = "lab", filter: str | None = None,
        changes: Changes | None = None, render_mode: None = None,
    ) -> None:  # fmt: skip
        if filter not in (None, *FILTERS):
            raise ConfigError(f"filter: found {filter!r}, allowed: None, {', '.join(map(repr, FILTERS))}")
        self.render_mode = render_mode
        self.scenario = single(scenario, changes, filter or "paper")
        self._enforces = filter is not None  # whether the barrier is enforced, in addition to the limits
        most = np.array(self.scenario.onboard.limits.velocity_max_m_s)
        self.action_space = spaces.Box(-most, most, dtype=np.float64)
        self.observation_space = spaces.Box(-_SPEED_FAR_M, _SPEED_FAR_M, (13,), np.float64)
        warm_up(self.scenario)
        self._companion: Companion | None = None
        self._flight: greenlet | None = None
        self._builtin: Vec3 = ZERO
        self._distance_m = 0.0
        self._seen = np.zeros(13)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start the flight of a seed, and fly until the stack requests a velocity.

        Args:
            seed: seed of the flight, as for ``fs.land``; None: a random seed.
            options: unused.

        Raises:
            RuntimeError: the flight ended before the landing started.
        """
        super().reset(seed=seed, options=options)
        self.close()
        flown = int(self.np_random.integers(2**31)) if seed is None else whole("seed", seed)
        controller = Controller(self.scenario.onboard)
        controller.strategy.ask = self._ask
        controller.velocity.program.enforces = self._enforces
        flights = Flights(self.scenario, flown, controller=controller)
        (self._companion,) = flights.members
        self._flight = greenlet(flights.fly)
        at = self._flight.switch()
        if at is None:
            raise RuntimeError(f"seed {flown}: the flight ended before the landing began")
        return self._observed(at), {"seed": flown}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Fly with the velocity ``action`` until the stack requests the next velocity or the flight is over.

        Args:
            action: nominal velocity, (3,), m/s ENU.

        Raises:
            RuntimeError: ``reset`` was not called, or the flight is over.
            ValueError: the action is not three finite numbers.
        """
        flight, companion = self._flight, self._companion
        if flight is None or companion is None:
            raise RuntimeError("step: call reset first; a flight that is over has no further step")
        x, y, z = np.asarray(action, dtype=np.float64).tolist()
        if not np.isfinite(x + y + z):
            raise ValueError(f"action: found {action}, three finite numbers (m/s ENU) are needed")
        before_m = self._distance_m
        at = flight.switch((x, y, z))
        if at is not None:
            seen = self._observed(at)
            reward = STEP_REWARD + APPROACH_REWARD_1_M * (before_m - self._distance_m)
            below = seen[9] < VIOLATION_LIMIT_M and at.d_m > self.scenario.target.pad_radius_m
            return seen, reward + (VIOLATION_REWARD if below else 0.0), False, False, {}
        self._flight = None
        flown = companion.seen()
        verdict = judge_truth(flown, flown.truth)
        late = verdict.outcome is Outcome.TIMEOUT or TIME_OVER in verdict.reason
        reward = 0.0 if late else END_REWARD.get(verdict.outcome, OTHER_END_REWARD)
        info = {
            "verdict": verdict,
            "outcome": verdict.outcome.value,
            "violation": verdict.violation,
            "h_min_outside_pad_m": verdict.h_min_outside_pad_m,
            "is_success": verdict.outcome is Outcome.LANDED,
        }
        return self._seen, STEP_REWARD + reward, not late, late, info

    def builtin_action(self) -> np.ndarray:
        """Return the nominal velocity that the stack itself would choose in this tick, m/s ENU, (3,).

        The velocity can exceed the action space. If each step uses it as action, the flight equals the flight
        of ``fs.land``.
        """
        return np.array(self._builtin)

    @property
    def truth(self) -> Truth:
        """True states of the finished flight, as in ``Landing.truth``.

        Raises:
            RuntimeError: no flight has ended yet.
        """
        if self._companion is None or self._flight is not None:
            raise RuntimeError("truth: no flight is over; step until terminated or truncated")
        return self._companion.seen().truth

    def close(self) -> None:
        """End the flight of the present episode, if it still runs."""
        flight, self._flight = self._flight, None
        if flight is not None:
            flight.throw()  # raises GreenletExit inside the flight

    def _ask(self, at: Relative, own: Vec3) -> Vec3:
        """Suspend the flight until the agent has chosen a velocity; return the permitted velocity."""
        self._builtin = own
        flight, companion = self._flight, self._companion
        assert flight is not None
        assert companion is not None
        return companion.controller.strategy.permitted_m_s(flight.parent.switch(at), own, at)

    def _observed(self, at: Relative) -> np.ndarray:
        companion = self._companion
        assert companion is not None
        v, t, e = at.own.velocity_enu_m_s, at.target.velocity_enu_m_s, at.e_m
        controller = companion.controller
        self._distance_m = (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]) ** 0.5
        slip = (v[0] - t[0], v[1] - t[1], v[2] - t[2])
        self._seen = np.array((*e, *slip, *t, controller.config.barrier.h(e), *controller.memory.command))
        return self._seen


make_env = LandingEnv


if ENV_ID not in gymnasium.registry:  # the id is missing if Gymnasium was imported after flightstack
    gymnasium.register(ENV_ID, "flightstack.api.env:LandingEnv")
