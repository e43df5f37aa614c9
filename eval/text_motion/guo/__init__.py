"""Guo et al.'s evaluator of text and motion."""
