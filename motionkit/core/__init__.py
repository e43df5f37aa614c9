"""What everything else stands on: files that are whole, checksums."""

__version__ = "0.1.0"
