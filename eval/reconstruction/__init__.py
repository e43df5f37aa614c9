"""How well a model reconstructs motion."""
