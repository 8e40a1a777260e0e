"""The onboard process: position loop, landing barrier, safety filter, phase machine, gate."""
