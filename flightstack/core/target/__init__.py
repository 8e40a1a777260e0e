"""Estimators: target, plausibility of the vehicle state, thrust reserve."""
