"""Motion fields: continuous-time motions, the encoders that fit them to observed frames, and operations on them."""
