"""Sensors: bind metadata to the observation equations."""
