"""Looking at motion: the player's page, strips, films."""
