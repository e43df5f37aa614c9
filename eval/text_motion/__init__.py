"""From a store, trained runs and sample folders to embeddings of texts and motions, row by row of a table."""
