"""Removes foot sliding: contacts are detected once, then a motion field that wraps another plants the feet."""
