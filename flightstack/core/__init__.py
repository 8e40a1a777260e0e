"""Pure flight controller: ``controller.py`` runs its tick, ``command.py`` computes the set-point.

``mission/`` decides the phase, ``fleet/`` avoids other vehicles, ``strategies/`` contains the safety filters,
``safety/`` barrier, quadratic program and gate, ``target/`` the estimators, ``parameters/`` the configuration
and ``memory.py`` the complete state. From the rest of this project, the controller imports only ``common``.
"""
