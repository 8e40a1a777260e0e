"""Fits a vehicle's file to a folder of recorded flights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from sim.flights.recording import Group, RecordingError, find_recordings
from sim.flights.screening import load as load_flight
from sim.plant.params import Params
from sim.scenarios.scenario import VEHICLE_FILES
from sim.validation.fit import LEVEL, Fit, FlightFit, Number, fit_flight, fitted

FULL_V = 3.7  # voltage under load to which ``thrust_max_n`` refers


def gather(
    folder: Path, columns: Mapping[str, Group], params: Params, done: Callable[[], object] = lambda: None
) -> tuple[list[FlightFit], dict[str, str]]:
    """Fit each flight of a folder separately; ``done`` is called after each flight.

    Returns the fits, and the names of the other flights, each with the reason.

    Raises RecordingError: the folder has no recordings, or none that can be fitted.
    """
    fits, left_out = [], dict[str, str]()
    for path in find_recordings(folder):
        try:
            flight = load_flight(path, columns)
            found = fit_flight(flight, params) if flight.usable else None
        except RecordingError as error:
            left_out[path.stem] = str(error)
        else:
            if found is None:
                reasons = "; ".join(reason.text for reason in flight.left_out) or "too short"
                left_out[path.stem] = reasons
            else:
                fits.append(found)
        done()
    if not fits:
        told = "\n".join(f"  {name}: {reason}" for name, reason in left_out.items())
        raise RecordingError(f"{folder}: none of {len(left_out)} flights can be fitted:\n{told}")
    return fits, left_out


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
