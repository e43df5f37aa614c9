"""A small evaluator after TMR that a store trains: texts and motions in one space, for retrieval."""
