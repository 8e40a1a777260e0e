"""Fleets without a leader: how vehicles keep apart, and in which order they land.

Around each pair of vehicles lies an ellipsoid with the barrier h = r_xy (rho - 1). h >= 0 gives one linear
constraint on this vehicle's velocity. Each of the two vehicles takes a share of the avoidance (none, half or
all), and both shares sum to at least 1 (``pair.py``). In each tick ``member.py`` adds one constraint for each
neighbour within reach. ``program.py`` finds the nearest velocity that meets all of them, with OSQP;
``solution.py`` is the exact solution that OSQP starts from and is compared with. Each vehicle also steps
aside to its right. ``precedence.py`` gives the right of way to land to the oldest claim.
"""
