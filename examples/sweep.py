"""Fly the same seeds with several barrier rates and several winds; print a table and write a figure.

python examples/sweep.py [SEEDS [PLOT.html]]
"""

import sys

import flightstack as fs

seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
grid = {"barrier.omega_1_s": [0.5, 0.7, 1.0], "wind.mean_m_s": [0.0, 1.0]}
sweep = fs.sweep("lab", grid, seeds, filter="paper")
print(fs.frame(sweep.rates()))
if len(sys.argv) > 2:
    sweep.plot().write_html(sys.argv[2])
