"""MAVLink: endpoint, codec, transports, signing, client and server of a vehicle."""
