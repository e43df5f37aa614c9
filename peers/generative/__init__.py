"""Other people's generative systems: a network's file and a row of `recipes.py` each; all else is written once."""
