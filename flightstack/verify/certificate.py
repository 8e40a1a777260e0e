"""Proof, before take-off, that a configuration is safe in its complete declared envelope.

``checks`` proves or refutes each claim of docs/how_it_works/robust_filter.md at its worst point. ``problems``
are the refuted claims that are necessary for a landing: the onboard process rejects a configuration with such
a claim. Each filter class has its own check function, because the proof of a class does not cover its
subclasses. The paper's filter has only the paper's checks, which guarantee nothing for a vehicle with lag.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from flightstack.common.strict_toml import ConfigError
from flightstack.core.parameters.filters import referred
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import checked_class, strategy_class
from flightstack.verify import ends, feedback, late, paper, robust, touchdown
from flightstack.verify.bound import Shape, Span
from flightstack.verify.envelope import extremes
from flightstack.verify.fleet import fleet_checks
from flightstack.verify.types import Check, Need


def problems(config: FlightConfig) -> list[str]:
    """Return the reasons why this configuration must not fly; empty if a flight is allowed."""
    return [check.text for check in checks(config) if check.need is Need.FLIGHT and not check.proven]


def refuse(configs: Iterable[FlightConfig], name: str | Path = "") -> None:
    """Raise ConfigError if one of these configurations must not fly; ``name``: its file."""
    if found := dict.fromkeys(problem for config in configs for problem in problems(config)):
        raise ConfigError(f"{name and f'{name}: '}refused before take-off: {'; '.join(found)}")


def certificate_of(config: FlightConfig) -> str:
    """Return the name of the certificate that the filter's class itself declares; empty: it declares none."""
    return str(vars(strategy_class(config.filter)).get("certificate", ""))


def checks(config: FlightConfig) -> list[Check]:
    """Return every check of the configuration's filter, and of its table [fleet] if it has one.

    Raises ConfigError: there is no such filter, or it rejects the configuration; ValueError: a parameter
    leads to a bound that is not a number.
    """
    checked_class(config)
    own = certificate_of(config)
    found: list[Check] = referred(own, "certificate")(config) if own else [
        Check("certificate", "the class of the filter has a certificate of its own", -math.inf, "",
              f"{config.filter} has none; the certificate of a base class does not cover it",
              "set the class attribute certificate to MODULE:NAME of a function that returns its checks",
              Need.PROOF),
    ]  # fmt: skip
    return [*found, *fleet_checks(config)]


def paper_checks(config: FlightConfig) -> list[Check]:
    shape, omega_1_s = Shape(config.barrier, Span(0.0, 0.0), 1.0), config.barrier.omega_1_s
    rate, slew = ("barrier.omega_1_s", omega_1_s), ("limits.slew_max_m_s2", config.limits.slew_max_m_s2)
    return [
        *paper.basics(config, shape, config.envelope.target_climb_max_m_s, rate, slew),
        *paper.answers(config),
        touchdown.modelled(config),
        ends.reaches_touchdown(config),
        *ends.any_filter(config, config.touchdown.descent_m_s, "touchdown.descent_m_s"),
    ]


def robust_checks(config: FlightConfig) -> list[Check]:
    x, own, fed_back = extremes(config), config.robust, config.velocity_feedback.horizontal
    rate, slew = ("robust.rate_1_s", own.rate_1_s), ("robust.acceleration_max_m_s2", config.slew_max_m_s2)
    return [
        *paper.basics(config, x.shape, x.target_climb_m_s, rate, slew),
        *robust.outside_pad(config, x),
        *touchdown.over_pad(config, x),
        *ends.any_filter(config, own.descent_m_s, "robust.descent_m_s"),
        *(feedback.comes_to_rest(config) if fed_back else late.comes_to_rest(config)),
    ]
