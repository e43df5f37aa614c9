"""`motionkit view`: any motion that motionkit reads, found, cut to a stretch, and shown in a page."""

# Of more, nobody sees anything, and a page may become too large for a browser.
MOST_MOTIONS = 24
