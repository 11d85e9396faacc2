"""Metadata files of sensors: one module per format, with its registration record (docs/extending/sensor.md)."""
