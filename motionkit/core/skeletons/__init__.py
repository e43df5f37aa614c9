"""Tables that say how each family of skeletons maps to the standard layouts (data; see `mapping`)."""
