"""Pure flight controller with one step per tick; it imports only ``common`` from the rest of the project."""
