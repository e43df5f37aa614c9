"""Removal of foot sliding: `motionkit plant` for clips, and `motionkit.edit.plant` for a motion."""
