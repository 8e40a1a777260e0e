"""The MuJoCo world: vehicle, deck, contact."""
