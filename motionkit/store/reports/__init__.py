"""What is in a store, in numbers."""
