"""The diffusion process that latent and pose-space diffusion models share, and its settings."""
