"""Random clips at native framerates: windows of a corpus, batches of their poses, the order of training."""
