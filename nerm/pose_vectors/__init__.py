"""What a motion field learns at each instant, in which numbers and at which scale."""
