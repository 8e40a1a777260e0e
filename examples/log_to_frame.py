"""Read a flight log into a table of columns, print some of its numbers, and save the table as CSV.

python examples/log_to_frame.py runs/first/flight.mcap [OUT.csv]
The CSV file needs pandas: pip install -e '.[export]'
"""

import sys

import numpy as np

import flightstack as fs

landing = fs.read_log(sys.argv[1])
for phase, begin_s, end_s in landing.flight.phase_spans():
    print(f"{begin_s:6.2f} to {end_s:6.2f} s  {getattr(phase, 'name', phase)}")
steps = landing.log  # one array per logged field; NaN in ticks without the filter
change_m_s = np.linalg.norm(steps.filtered_enu_m_s - steps.nominal_enu_m_s, axis=1)
print(f"{len(steps.t_s)} steps; the filter changes the velocity by {np.nanmax(change_m_s):.2f} m/s at most")
print(f"lowest h of the estimate: {1000.0 * np.nanmin(steps.h_m):+.0f} mm")
if landing.truth is not None:  # the log of a real vehicle contains no true states
    print(f"lowest true h: {1000.0 * np.nanmin(landing.truth.h_min_m):+.0f} mm")

table = fs.frame(steps)  # DataFrame of pandas or polars; a vector has a column for each axis, e.g. e_m_x
# the last columns are e_m, the position relative to the landing spot, and d_m, the horizontal distance to it
print("columns:", ", ".join(list(table)[:8]), "...")
if len(sys.argv) > 2:
    table.to_csv(sys.argv[2], index=False)  # method of pandas; that of polars is ``write_csv``
