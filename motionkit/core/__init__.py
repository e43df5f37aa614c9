"""What everything else stands on: files that are whole, checksums."""
