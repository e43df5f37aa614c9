"""Commands of the evaluator suite."""
