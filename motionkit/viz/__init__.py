"""Looking at motion: the player's page, strips, films."""

# The most motions in one page: more are too small to see, and the page may become too large for a browser.
MOST_MOTIONS = 24
