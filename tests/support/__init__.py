"""Helpers shared by tests of several floors."""
