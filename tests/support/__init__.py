"""Helpers are shared by tests of several folders."""
