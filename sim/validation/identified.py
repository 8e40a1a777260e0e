"""Fits a vehicle's file to a folder of recorded flights, and tests the fit on paths outside its data."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim.flights.recording import Group, RecordingError, find_recordings
from sim.flights.screening import Screened
from sim.flights.screening import load as load_flight
from sim.plant.params import Params
from sim.scenarios.scenario import VEHICLE_FILES
from sim.validation.fit import LEVEL, Fit, FlightFit, Number, fit_flight, fitted, together
from sim.validation.open_loop import HORIZONS_S, Compared, compare

FULL_V = 3.7  # voltage under load to which ``thrust_max_n`` refers


@dataclass(frozen=True, slots=True)
class Gathered:
    """Flights of a folder and their fits."""

    flights: tuple[tuple[Screened, FlightFit], ...]  # fitted flights with their fits
    left_out: tuple[tuple[str, str], ...]  # names of the other flights, each with the reason

    @property
    def fits(self) -> list[FlightFit]:
        return [fit for _, fit in self.flights]


def gather(
    folder: Path, columns: Mapping[str, Group], params: Params, done: Callable[[], object] = lambda: None
) -> Gathered:
    """Fit each flight of a folder separately; ``done`` is called after each flight.

    Raises RecordingError: the folder has no recordings, or none that can be fitted.
    """
    flights, left_out = [], []
    for path in find_recordings(folder):
        try:
            flight = load_flight(path, columns)
            found = fit_flight(flight, params) if flight.usable else None
        except RecordingError as error:
            left_out.append((path.stem, str(error)))
        else:
            if found is None:
                reasons = "; ".join(reason.text for reason in flight.left_out) or "too short"
                left_out.append((path.stem, reasons))
            else:
                flights.append((flight, found))
        done()
    if not flights:
        told = "\n".join(f"  {name}: {reason}" for name, reason in left_out)
        raise RecordingError(f"{folder}: none of {len(left_out)} flights can be fitted:\n{told}")
    return Gathered(tuple(flights), tuple(left_out))


def kind(name: str) -> str:
    """Return the path in a flight's file name, e.g. B2_circle for B2_circle_fast_rep1."""
    return re.sub(r"(_(slow|medium|fast))?(_rep\d+)?$", "", name)


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Prediction error on one kind of path, by a fit to the other kinds."""

    kind: str  # kind of path
    flights: int  # number of flights
    # ratios of errors to constant velocity at ``HORIZONS_S``, medians over the flights; ideal: rigid body
    position: list[float]
    ideal_position: list[float]
    velocity: list[float]
    ideal_velocity: list[float]


def _ratios(errors: Compared) -> tuple[float, float]:
    return errors.model / errors.constant_velocity, errors.ideal / errors.constant_velocity


def leave_one_out(gathered: Gathered, params: Params) -> list[LeftOut]:
    """Predict each kind of path by a fit to the other kinds. Raises ValueError: only one kind."""
    kinds = sorted({kind(fit.name) for fit in gathered.fits})
    if len(kinds) < 2:
        raise ValueError(f"found flights of one path only ({kinds[0]}), to leave one out takes two at least")
    rows = []
    for left in kinds:
        fit = together([one for one in gathered.fits if kind(one.name) != left])
        vehicle = fitted(params, fit.values)
        found = [compare(flight, vehicle) for flight, one in gathered.flights if kind(one.name) == left]
        compared = [one.horizons for one in found if one is not None]
        ratios = np.array(
            [[_ratios(h.position_m), _ratios(h.velocity_m_s)] for flight in compared for h in flight]
        )
        shape = (len(compared), len(HORIZONS_S), 2, 2)
        position, velocity = np.median(ratios.reshape(shape), axis=0).transpose(1, 2, 0).tolist()
        rows.append(LeftOut(left, len(compared), *position, *velocity))
    return rows


def toml(fit: Fit, params: Params, base: str) -> str:
    """Return a vehicle file with the fitted numbers and their sources; ``base``: a name or a file."""
    vehicle, n = fitted(params, fit.values), fit.numbers
    if base not in VEHICLE_FILES.names():
        base = str(Path(base).resolve())
    mass = params.body.mass_kg
    drag, climb, inertia = n["drag_1_s"], n["climb_drag_1_s"], n["inertia_kg_m2"]
    drags = ", ".join(f"{value:.3g}" for value in vehicle.body.drag_n_s_m)
    inertias = ", ".join(f"{value:.3g}" for value in vehicle.body.inertia_kg_m2)
    full_n = vehicle.rotor.thrust_n(vehicle.battery.speed_rpm(FULL_V))
    at_zero, per_volt = vehicle.battery.speed_at_zero_v_rpm, vehicle.battery.speed_per_volt_rpm
    lines = [
        f"# Fitted by `flightstack identify --flights` to {len(fit.flights)} flights: median of the flights;",
        f"# in brackets the {LEVEL:.0%} interval of that median and the standard deviation of the flights.",
        f"# Mass ({mass:g} kg) and thrust curve are those of the base: flights show accelerations only.",
        f'base = "{base}"',
        "",
        "[body]",
        f"drag_n_s_m = [{drags}] # {_told(drag)} 1/s times mass; climbing {_told(climb)} 1/s",
        f"inertia_kg_m2 = [{inertias}] # {_told(inertia)}; about z that of the base",
        f"drag_above_com_m = {n['drag_above_com_m'].value:.4f} # {_told(n['drag_above_com_m'])}",
        f"rate_damping_n_m_s = {vehicle.body.rate_damping_n_m_s:.3g} # {_told(n['rate_damping_1_s'])} 1/s",
        "",
        "[rotor]",
        f"thrust_max_n = {full_n:.4f} # at full duty and {FULL_V:g} V",
        f"lag_s = {n['lag_s'].value:.4f} # {_told(n['lag_s'])}",
        "",
        "[battery]",
        f"resistance_ohm = {vehicle.battery.resistance_ohm:.3f} # {_told(n['resistance_ohm'])}",
        f"speed_at_zero_v_rpm = {at_zero:.0f}.0 # hover: {_told(n['hover_v'])} V and",
        f"speed_per_volt_rpm = {per_volt:.0f}.0 # its exponent {_told(n['exponent'])}",
        f"# delay from a logged command to the gyro, beyond the lag: {_told(n['delay_s'])} s",
    ]
    return "\n".join(lines) + "\n"


def _told(number: Number) -> str:
    return f"{number.value:.3g} [{number.low:.3g} to {number.high:.3g}; {number.spread:.2g}]"
