"""The motion field f_θ(t, z, s) → pose: network, training, encoding of new motions, reconstruction."""
