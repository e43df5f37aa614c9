"""Interpolators: observed frames, at even or uneven times, as motion fields (`motionkit.interpolation.fields`)."""
