"""Memory maps for training, made from a store."""
