"""Feet that slide made to stand: what `motionkit plant` does with each clip, and `motionkit.plant` with a motion."""
