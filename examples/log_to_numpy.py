"""Read a flight log into numpy arrays, print some numbers of it, and save arrays as .npz.

python examples/log_to_numpy.py runs/first/flight.mcap [OUT.npz]
"""

import sys

import numpy as np

from logs.reader.flight import load_flight

flight = load_flight(sys.argv[1])
steps, truth = flight.steps, flight.truth  # None where the log holds none: a real vehicle has no true states
if steps is None:
    sys.exit(f"{flight.path}: the log holds no controller steps")

for phase, begin_s, end_s in flight.phase_spans():
    print(f"{begin_s:6.2f} to {end_s:6.2f} s  {getattr(phase, 'name', phase)}")
# (n,); NaN in ticks in which the filter does not run
change_m_s = np.linalg.norm(steps.filtered_enu_m_s - steps.nominal_enu_m_s, axis=1)
print(f"{len(steps.t_s)} steps; the filter changes the velocity by {np.nanmax(change_m_s):.2f} m/s at most")
print(f"lowest h of the estimate: {1000.0 * np.nanmin(steps.h_m):+.0f} mm")

arrays = {"t_s": steps.t_s, "phase": steps.phase, "h_m": steps.h_m, "command_enu_m_s": steps.command_enu_m_s}
if truth is not None:
    print(f"lowest true h: {1000.0 * np.nanmin(truth.h_min_m):+.0f} mm")
    arrays |= {"true_t_s": truth.t_s, "true_position_enu_m": truth.position_enu_m, "true_h_m": truth.h_m}
if len(sys.argv) > 2:
    np.savez(sys.argv[2], **arrays)
