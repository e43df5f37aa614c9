"""The parts of the page; `motionkit.player.page` puts them into one file."""
