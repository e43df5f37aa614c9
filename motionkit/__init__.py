"""Human motion at native framerates: what a motion is, how it gets in and out, where it rests."""

from motionkit.core.version import __version__ as __version__
