"""Readers and writers of motions in numpy files (.npy, .npz), which may be untrusted."""
