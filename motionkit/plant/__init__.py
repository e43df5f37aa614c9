"""Removal of foot sliding: `motionkit plant` for clips, and `motionkit.plant` for a motion."""
