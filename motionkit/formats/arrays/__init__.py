"""Numpy files (.npy, .npz) that may come from strangers, and the motions in them."""
