"""A preference study: people see two motions and say which is better (NeRM's figure 10)."""
