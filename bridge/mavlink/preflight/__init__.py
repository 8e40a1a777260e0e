"""What a vehicle is asked before a flight, and the rules for its answers."""
