"""The published text-motion evaluator (Guo et al. 2022), from the user's own files."""
