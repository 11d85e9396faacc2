"""Metadata formats of sensors.

Each format has one module with its registry record (docs/extending/sensor.md).
"""
