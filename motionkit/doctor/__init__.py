"""Checks of `motionkit doctor`: the machine, the installation, the store, the runs; quick ones only."""
