"""The learned evaluator that describes clips of any framerate."""
