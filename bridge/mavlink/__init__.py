"""MAVLink: endpoint, codec, transports, signing, client of a vehicle."""
