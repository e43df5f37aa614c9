"""Feature extractors and evaluator networks."""
