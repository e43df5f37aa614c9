"""Motions out of a trained model, in memory: what is asked for becomes motion fields, sampled at any framerate."""
