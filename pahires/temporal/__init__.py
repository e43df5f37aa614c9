"""Networks that complete motion from windows of observed frames: data, training and encoders."""
