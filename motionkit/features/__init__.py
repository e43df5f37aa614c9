"""Pose vectors of motions, their inverse and their statistics."""
