"""Latents: one N(μ, Σ) per window of motion, and how a field reads z along time."""
