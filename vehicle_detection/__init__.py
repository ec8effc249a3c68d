"""The package behind the scripts: detectors, media, tracking, evaluation."""
