"""The commands that NeRM adds to motionkit, one file each."""
