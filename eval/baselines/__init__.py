"""Rows that any model has to be compared with: motion known at a low framerate only, and upsampled."""
