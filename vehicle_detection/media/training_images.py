"""Training images as windows: read on all cores, whatever their size."""

import cv2
import numpy as np
from tqdm import tqdm

from vehicle_detection.compiled.threads import side_by_side
from vehicle_detection.media.images import read_image

# Handing images over one by one takes about as long again as reading them.
_IMAGES_PER_RUN = 500


def read_window(path, window_size):
    """Read an image as a window; one of another size is resized.

    Returns
    -------
    img : ndarray of uint8, shape (window_size, window_size, 3)
        RGB.
    resized : bool
    """
    img = read_image(path)
    if img.shape[:2] == (window_size, window_size):
        return img, False
    return cv2.resize(img, (window_size, window_size), interpolation=cv2.INTER_AREA), True


def read_windows(paths, window_size):
    """Read many images as windows, with a progress bar; says how many had to be resized.

    Parameters
    ----------
    paths : list of Path
    window_size : int

    Returns
    -------
    images : ndarray of uint8, shape (len(paths), window_size, window_size, 3)
        RGB.

    Raises
    ------
    FileNotFoundError, ValueError
        See `files.read_image`; names the file.
    """
    images = np.empty((len(paths), window_size, window_size, 3), np.uint8)
    resized = np.zeros(len(paths), bool)
    with tqdm(total=len(paths), desc="images", unit="image") as progress:

        def fill(first):
            """Read the run of images that begins here."""
            run = range(first, min(first + _IMAGES_PER_RUN, len(paths)))
            for i in run:
                images[i], resized[i] = read_window(paths[i], window_size)
            progress.update(len(run))

        side_by_side(fill, range(0, len(paths), _IMAGES_PER_RUN))
    if resized.any():
        size, first = f"{window_size}x{window_size}", paths[resized.argmax()]
        print(f"resized to {size}: {resized.sum()} images, the first {first}")
    return images
