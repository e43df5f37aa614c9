"""Sample sets: motions of one framerate, real or generated, that tables compare."""
