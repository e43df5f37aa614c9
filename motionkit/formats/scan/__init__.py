"""From a folder to sequences: what lies in it, which stretch of which file, and reading it."""
