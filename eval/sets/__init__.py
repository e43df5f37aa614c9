"""Sets of motions that are compared: real, upsampled, generated, samples of other systems."""
