"""Model of the Crazyflie's firmware: attitude and velocity loops, mixer, estimator, supervisor."""
