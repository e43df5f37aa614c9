"""Interpolators: observed frames, at even or uneven times, as motion fields (`interpolators`)."""
