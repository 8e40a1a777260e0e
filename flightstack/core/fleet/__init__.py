"""Fleets without a leader: constraints between vehicles, and the order of landings.

``member.py`` has the steps of a tick. For each neighbour it adds the constraint of ``pair.py``, which also
gives the share of the avoidance; ``precedence.py`` gives the right of way to land. ``assignment.py`` assigns
the pads before the flight. ``program.py`` solves for the velocity with OSQP, and ``solution.py`` computes the
exact solution that OSQP starts from and is compared with.
"""
