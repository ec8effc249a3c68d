"""The two-stage detector."""
