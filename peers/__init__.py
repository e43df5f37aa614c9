"""Other people's systems, a file for each kind of network: those that generate motion, and those that complete it."""
