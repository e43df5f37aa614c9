"""Protocols: how published evaluations draw, pair and repeat, as data."""
