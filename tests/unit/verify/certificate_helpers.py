"""Configurations for tests of the certificate, with all relevant numbers given explicitly."""

from flightstack.common.strict_toml import from_table
from flightstack.core.parameters.flight import FlightConfig
from flightstack.verify.certificate import checks

BASE = {
    "barrier": {"alpha_1_m": 1.0, "beta_m": 1.5},
    "limits": {"velocity_max_m_s": [1.0, 1.0, 1.0], "altitude_max_m": 3.0},
    "touchdown": {
        "target_speed_max_m_s": 0.5, "pad_radius_m": 0.1, "feet_below_reference_m": 0.0144,
    },
    "checks": {"target_speed_max_m_s": 1.5, "target_age_max_s": 0.25},
    "robust": {
        "rate_1_s": 1.5, "tracking_error_m_s": 0.04, "sigma_factor": 2.0, "fade_radius_m": 0.06,
        "acceleration_max_m_s2": [2.0, 2.0, 2.5], "gain_1_s": 1.2, "gain_over_pad_1_s": 1.8,
        "wait_height_m": 0.1, "commit_height_m": 0.22, "commit_radius_m": 0.03, "commit_speed_m_s": 0.1,
        "corridor_m": 0.085, "descent_m_s": 0.22, "touch_height_m": 0.05,
    },
    "velocity_loop": {"lag_xy_s": 0.27, "lag_z_s": 0.17},
    "own": {"position_noise_m": 0.002},
    "target": {
        "delay_s": 0.02, "position_noise_m": 0.005, "velocity_noise_m_s": 0.02, "jerk_xy_m_s3_sqrthz": 0.6,
        "jerk_z_m_s3_sqrthz": 0.6, "acceleration_xy_m_s2": 0.3, "acceleration_z_m_s2": 0.3,
    },
    "envelope": {
        "target_climb_max_m_s": 0.0, "target_acceleration_max_m_s2": 0.5, "target_rate_hz": 50.0,
        "lag_spread": 0.3,
    },
}  # fmt: skip


def config(**sections):
    """Return a configuration: ``BASE`` with replaced keys, e.g. ``config(robust={"rate_1_s": 2.0})``."""
    table = {name: dict(values) for name, values in BASE.items()}
    for name, values in sections.items():
        if isinstance(values, dict):
            table.setdefault(name, {}).update(values)
        else:
            table[name] = values
    return from_table(FlightConfig, table)


def rooms(**sections):
    return {check.name: check.room for check in checks(config(**sections))}


def one(name, **sections):
    (found,) = (check for check in checks(config(**sections)) if check.name == name)
    return found
