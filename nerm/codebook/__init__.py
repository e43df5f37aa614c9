"""The VQ-VAE whose codes enrich the coordinates: network, training, T2M-GPT's published weights."""
