"""Summary statistics of stores."""
