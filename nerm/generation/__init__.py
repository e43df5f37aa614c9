"""What `motionkit generate` is asked for, plans, samples and writes, whichever model made it."""
