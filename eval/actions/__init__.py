"""Action recognisers, and the motions that they are evaluated on."""
