"""A Crazyflie's firmware as far as cflib sees it: CRTP on a UDP socket, supervisor, set-point watchdog."""
