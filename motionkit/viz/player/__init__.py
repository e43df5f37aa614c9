"""The page of moving skeletons: one HTML file that opens from disk, for `motionkit view` and `complete --compare`."""
