"""Parameters of the configuration: dataclasses with the unit and allowed range of each number."""
