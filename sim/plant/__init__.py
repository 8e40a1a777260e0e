"""The vehicle's physics: parameters, battery, rotors, wind, ground effect, sensors."""
