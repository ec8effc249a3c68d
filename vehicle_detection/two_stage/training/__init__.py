"""Training of the two-stage detector."""
