"""The latent diffusion: process, network, corpus of posteriors, training, sampling (paper §3.2)."""
