"""What may be configured: dataclasses with unit and allowed range of each number."""
