"""Many seeded landings of one scenario: ``run`` flies, ``rows`` stores, ``summary`` condenses them."""
