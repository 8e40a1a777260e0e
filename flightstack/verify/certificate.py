"""Proof, before take-off, that a configuration is safe over its whole declared envelope.

``checks`` proves or refutes each claim of docs/how_it_works/robust_filter.md at its worst point.
``problems`` are the refuted claims that are necessary for a landing: the onboard process rejects such a
configuration. Each filter class has its own function of checks: the proof of a class does not cover its
subclasses. The paper's filter has only the paper's checks, which guarantee nothing for a vehicle with lag.
"""

from __future__ import annotations

import math

from flightstack.core.parameters.filters import referred
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import strategy_class
from flightstack.verify import ends, feedback, late, paper, robust, touchdown
from flightstack.verify.bound import Shape, Span
from flightstack.verify.envelope import extremes
from flightstack.verify.fleet import fleet_checks
from flightstack.verify.types import Check, Need


def problems(config: FlightConfig) -> list[str]:
    """Return the reasons why this configuration must not fly; empty if it may."""
    return [check.text for check in checks(config) if check.need is Need.FLIGHT and not check.proven]


def certificate_of(config: FlightConfig) -> str:
    """Return the name of the checks that the filter's class itself declares; empty: no certificate."""
    return str(vars(strategy_class(config.filter)).get("certificate", ""))


def checks(config: FlightConfig) -> list[Check]:
    """Return every check of the configuration's filter, and of its table [fleet] if it has one.

    Raises ConfigError: there is no such filter, or it rejects the configuration; ValueError: a parameter
    leads to a bound that is not a number.
    """
    strategy = strategy_class(config.filter)
    strategy.check_config(config)
    own = certificate_of(config)
    found: list[Check] = referred(own)(config) if own else [_no_certificate(config.filter)]
    return [*found, *fleet_checks(config)]


def _no_certificate(name: str) -> Check:
    return Check(
        "certificate",
        "the class of the filter has a certificate of its own",
        -math.inf,
        "",
        f"{name} has none; the certificate of a base class does not cover it",
        "set the class attribute certificate to MODULE:NAME of a function that returns its checks",
        Need.PROOF,
    )


def paper_checks(config: FlightConfig) -> list[Check]:
    shape = Shape(config.barrier.build(), Span(0.0, 0.0), 1.0)
    return [
        paper.feasible(config, shape, config.envelope.target_climb_max_m_s),
        paper.sampling(config, "barrier.omega_1_s", config.barrier.omega_1_s),
        paper.peak_clears_pad(config),
        paper.gains(config, config.position_loop.gain_1_s, "position_loop.gain_1_s"),
        paper.slews(config, config.limits.slew_max_m_s2, "limits.slew_max_m_s2"),
        paper.lags(config),
        *paper.answers(config),
        touchdown.modelled(config),
        ends.reaches_touchdown(config),
        ends.contact(config, config.touchdown.descent_m_s, "touchdown.descent_m_s"),
        ends.notices(config),
        ends.forgets(config),
        ends.falls(config),
    ]


def robust_checks(config: FlightConfig) -> list[Check]:
    x, fed_back, table = extremes(config), config.velocity_feedback.horizontal, config.reserve
    return [
        paper.feasible(config, x.shape, x.target_climb_m_s),
        robust.recovers(config, x),
        robust.rate(config, x),
        paper.sampling(config, "robust.rate_1_s", config.robust.rate_1_s),
        paper.peak_clears_pad(config),
        paper.gains(config, config.position_loop.gain_1_s, "position_loop.gain_1_s"),
        paper.slews(config, config.slew_max_m_s2, "robust.acceleration_max_m_s2"),
        *touchdown.follows(config, x),
        *touchdown.reach(config, x),
        touchdown.in_time(config, x),
        touchdown.stops(config, x),
        ends.contact(config, config.robust.descent_m_s, "robust.descent_m_s"),
        ends.notices(config),
        ends.forgets(config),
        ends.accepts(config),
        ends.falls(config),
        touchdown.altitude(config, x),
        robust.climb(config, x),
        robust.slew(config, x),
        *([robust.reserve(config, table, x)] if table is not None else []),
        robust.holds(config, x),
        robust.estimator(config, x),
        *([robust.own_estimator(config)] if config.own.learns and not fed_back else []),
        touchdown.tilts(config, x),
        touchdown.modelled(config),
        *(
            feedback.comes_to_rest(config)
            if fed_back
            else [touchdown.damping(config, x), *late.comes_to_rest(config)]
        ),
        touchdown.drift(config, x),
    ]
