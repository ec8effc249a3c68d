"""What was found in a video, as a page to browse."""
