"""Other people's systems, one file each: those that generate motion, and those that complete it as PA-HiRes does."""
