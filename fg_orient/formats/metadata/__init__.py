"""Metadata files of sensors: one module per format, each in the registry (docs/extending/sensor.md)."""
