"""Frozen text encoders from local weights, and their embeddings computed once."""
