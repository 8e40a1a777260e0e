"""How the autopilots differ, as tables."""
