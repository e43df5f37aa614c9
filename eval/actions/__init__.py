"""Motions whose actions a recogniser knows, and the recognisers that there are."""
