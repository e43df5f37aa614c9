"""Characters: rigs with their own bones, names and proportions, onto which motions are retargeted."""
