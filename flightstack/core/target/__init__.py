"""Target samples: plausibility, tracking, Kalman filter."""
