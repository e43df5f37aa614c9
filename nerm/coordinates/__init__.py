"""From seconds to what a network reads: coordinates, Fourier features, codebook-coordinate attention (paper §3.1)."""
