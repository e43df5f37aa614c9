"""Random clips at native framerates: windows of a corpus, their poses as torch batches, the order of a training."""
