"""Forwards motion capture poses to the vehicle: ``process`` holds the loop, ``checks`` the checks."""
