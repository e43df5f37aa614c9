"""Results rendered for people."""
