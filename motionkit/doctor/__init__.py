"""What `motionkit doctor` looks at: the machine, what is installed, the store, the runs; cheap checks alone."""
