"""The package behind the scripts: detectors, media, tracking, evaluation."""

__version__ = "1.0.0"
