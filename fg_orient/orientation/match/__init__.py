"""Measurement of tie points in the pixels of images: search along epipolar curves, and least-squares matching."""
