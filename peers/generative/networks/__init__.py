"""The networks of generative peers, a file each, and the layers that they share."""
