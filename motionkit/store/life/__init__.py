"""What is done to a store after it was written: remove, compact, merge, migrate, split."""
