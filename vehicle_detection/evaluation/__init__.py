"""Boxes against the truth."""
