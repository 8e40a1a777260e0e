"""Fleets without a leader: how vehicles keep apart, and in which order they land.

``pair.py`` has the barrier between two vehicles, the constraint on this vehicle, and its share of the
avoidance. In each tick ``member.py`` adds this constraint for each neighbour, and ``program.py`` solves for
the velocity with OSQP; ``solution.py`` is the exact solution that OSQP starts from and is compared with.
``precedence.py`` gives the right of way to land. ``assignment.py`` assigns the pads before the flight.
"""
