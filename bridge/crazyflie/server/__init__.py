"""The MAVLink side of the Crazyflie bridge."""
