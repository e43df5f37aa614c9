"""The parts of the page; `motionkit.export.player.page` puts them into one file."""
