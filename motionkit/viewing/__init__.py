"""`motionkit view`: any motion that motionkit reads, found, cut to a stretch, and shown in a page."""
