"""Fleets without a leader: how vehicles avoid each other, and in which order they land.

The offset of two vehicles must remain outside an ellipsoid. The barrier function of this ellipsoid gives one
linear constraint on this vehicle's velocity. Each of the two vehicles takes a share of the avoidance (none,
half or all), and both shares sum to at least 1 (``pair.py``). In each tick ``member.py`` adds one constraint
for each neighbour within reach. ``program.py`` finds with OSQP the velocity nearest to the nominal one that
satisfies all constraints; ``solution.py`` computes the exact solution, from which OSQP starts. A vehicle that
approaches another one also steps aside to the right. ``precedence.py`` gives the right of way to the vehicle
with the oldest claim.
"""
