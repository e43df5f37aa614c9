"""Motions completed and held against the truth: takes, encoders, what each table gives and asks for."""
