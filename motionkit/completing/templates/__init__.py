"""The page of `motionkit complete --compare`."""
