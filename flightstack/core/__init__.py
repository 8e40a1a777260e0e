"""Pure flight controller: ``controller.py`` has its tick, ``command.py`` filters and sends a velocity.

``mission/`` decides the phase, ``fleet/`` avoids other vehicles, ``strategies/`` are the safety filters,
``safety/`` has barrier, program and gate, ``target/`` the estimators, ``parameters/`` the configuration and
``memory.py`` the complete state. Outside this package the controller imports only ``common``.
"""
