"""Pose vectors made from motions, their inverse, their statistics."""
