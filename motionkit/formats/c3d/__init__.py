"""C3D: the container, its markers as a motion, and the gaps in them."""
