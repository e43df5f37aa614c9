"""The ablations of the paper and ours: which runs a table is made of, and their training."""
