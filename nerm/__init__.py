"""NeRM: neural representations for high-framerate human motion synthesis (variational INR + latent diffusion)."""
