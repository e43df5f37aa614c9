"""Human motion at native framerates: what a motion is, how it gets in and out, where it rests."""

__version__ = "0.1.0"
