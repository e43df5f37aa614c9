"""The training loop: run folder, checkpoints, resume, devices, progress, metrics log."""
