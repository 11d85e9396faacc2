"""Equations of images: pushbroom scanners, frame cameras, rational functions, transformations."""
