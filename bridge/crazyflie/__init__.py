"""A stock Crazyflie as a MAVLink vehicle, through cflib; ``process`` is the loop, ``vehicle`` the core."""
