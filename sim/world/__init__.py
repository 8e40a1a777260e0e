"""The physics of vehicle and deck, with contacts computed by MuJoCo."""
