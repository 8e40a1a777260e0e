"""What runs on the Crazyflie: attitude and velocity loops, mixer, estimator, supervisor."""
