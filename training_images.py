"""Features of the training images, on all cores.

Apart from `train.py`, so that the worker processes start without scikit-learn,
which takes two thirds of their start.
"""

import cv2
import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from files import read_image
from pipeline_functions import extract_features

_IMAGES_PER_TASK = 200


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


def features_of_files(paths, params):
    """Features of image files, and which of them had to be resized.

    Returns
    -------
    features : ndarray of float32, shape (len(paths), params.n_features)
    resized : list of Path
    """
    features = np.empty((len(paths), params.n_features), np.float32)
    resized = []
    for i, path in enumerate(paths):
        img, is_resized = read_window(path, params.window_size)
        features[i] = extract_features(img, params)
        if is_resized:
            resized.append(path)
    return features, resized


def extract_all(paths, params, jobs):
    """`features_of_files` on all cores, with a progress bar."""
    chunks = [paths[i : i + _IMAGES_PER_TASK] for i in range(0, len(paths), _IMAGES_PER_TASK)]
    results = Parallel(n_jobs=jobs, return_as="generator")(
        delayed(features_of_files)(chunk, params) for chunk in chunks
    )
    features, resized = [], []
    with tqdm(total=len(paths), desc="features", unit="image") as progress:
        for chunk_features, chunk_resized in results:
            features.append(chunk_features)
            resized += chunk_resized
            progress.update(len(chunk_features))
    if resized:
        size = params.window_size
        print(f"resized to {size}x{size}: {len(resized)} images, the first {resized[0]}")
    return np.concatenate(features)
