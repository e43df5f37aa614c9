"""Acclaim ASF/AMC: the skeleton and the takes that move it."""
