"""The learned evaluator that embeds clips of any framerate."""
