"""What a motion is conditioned on: text, action, duration, and classifier-free guidance."""
