"""A rendered motorway: the sample for machines without footage."""
