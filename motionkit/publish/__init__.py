"""Pushing stores and runs to the Hugging Face Hub with cards, and pulling with verification (docs/hub.md)."""
