"""From a folder to sequences: finding them, cutting files into them, and reading them."""
