"""`motionkit view`: show motions of any format, or a stretch of them, in a page."""

# More motions are too small to see, and a page may become too large for a browser.
MOST_MOTIONS = 24
