"""Estimators of target, vehicle state and thrust reserve, and plausibility checks."""
