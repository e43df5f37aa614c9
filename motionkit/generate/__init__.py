"""Generation by a trained model: requests become motion fields, sampled at any framerate."""
