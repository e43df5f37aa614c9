"""Embeddings of texts and motions from stores, trained runs and sample folders, for each row of a table."""
