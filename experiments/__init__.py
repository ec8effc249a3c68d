"""Experiments on the write-ups and the benchmark; needs the whole project."""
