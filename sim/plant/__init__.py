"""Physics models of the vehicle: parameters, battery, rotors, wind, ground effect, sensors."""
