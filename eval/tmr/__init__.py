"""A small TMR-style evaluator trained on a store: texts and motions in one space, for retrieval."""
