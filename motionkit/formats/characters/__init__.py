"""Characters: rigs with their own bones, names and proportions, that motions are written onto."""
