"""What comes in and goes out: images, videos, boxes, calibration, drawing."""
