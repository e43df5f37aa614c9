"""Foundations: motions, skeletons, kinematics, atomic files, checksums, errors."""

__version__ = "0.1.0"
