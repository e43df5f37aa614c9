"""Feet on the ground: contact is found once, and a motion field on a motion field lets the feet stand."""
