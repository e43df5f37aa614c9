"""What captures hold above 10 Hz, learnt from a store's takes: the stage `detail`."""
