"""Sensors connect the metadata of images with the observation equations."""
