"""The published way, window by window and pixel by pixel, to compare with.

Slow, and written from the description of the method, on scikit-image and
loops. `benchmark.py` times it too.
"""

import cv2
import numpy as np
from scipy.ndimage import label
from skimage.feature import hog


def hog_of_channel(channel, params):
    """HOG blocks of one channel by scikit-image, float64."""
    return hog(
        channel,
        orientations=params.orientations,
        pixels_per_cell=(params.pix_per_cell, params.pix_per_cell),
        cells_per_block=(params.cells_per_block, params.cells_per_block),
        transform_sqrt=True,
        block_norm="L2-Hys",
        feature_vector=False,
    )


_CODES = {
    "YCrCb": cv2.COLOR_RGB2YCrCb,
    "HSV": cv2.COLOR_RGB2HSV,
    "HLS": cv2.COLOR_RGB2HLS,
    "LUV": cv2.COLOR_RGB2LUV,
    "YUV": cv2.COLOR_RGB2YUV,
    "Lab": cv2.COLOR_RGB2Lab,
    "gray": cv2.COLOR_RGB2GRAY,
}


def channels_of(img, color):
    """An RGB image in another colour space, always with three dimensions."""
    converted = img if color == "RGB" else cv2.cvtColor(img, _CODES[color])
    return np.atleast_3d(converted)


def window_features(converted, hogs, row, column, params):
    """Features of the window whose corner lies at a row and column of the band."""
    size = params.window_size
    parts = []
    if params.spatial_color:
        window = converted[params.spatial_color][row : row + size, column : column + size]
        side = params.spatial_size
        parts.append(cv2.resize(window, (side, side)).ravel())
    if params.hist_color:
        window = converted[params.hist_color][row : row + size, column : column + size]
        for c in range(window.shape[2]):
            counts, _ = np.histogram(window[..., c], bins=params.hist_bins, range=(0, 256))
            parts.append(counts)
    first_row, first_column = row // params.pix_per_cell, column // params.pix_per_cell
    blocks = size // params.pix_per_cell - params.cells_per_block + 1
    for channel_hog in hogs:
        block = channel_hog[first_row : first_row + blocks, first_column : first_column + blocks]
        parts.append(block.ravel())
    return np.concatenate(parts).astype(np.float64)


def band_features(img, params, cells_per_step):
    """Features of every window of an image, shape (window rows, window columns, n)."""
    colors = {params.spatial_color, params.hist_color, params.hog_color} - {None}
    converted = {color: channels_of(img, color) for color in colors}
    hogs = []
    if params.hog_color:
        channels = converted[params.hog_color]
        chosen = range(channels.shape[2])
        if params.hog_channel != "ALL":
            chosen = [params.hog_channel]
        hogs = [hog_of_channel(channels[..., c], params) for c in chosen]
    step = cells_per_step * params.pix_per_cell
    rows = range(0, img.shape[0] - params.window_size + 1, step)
    columns = range(0, img.shape[1] - params.window_size + 1, step)
    return np.array(
        [[window_features(converted, hogs, r, c, params) for c in columns] for r in rows]
    )


def bands(frame_shape, search):
    """Scale, top, cropped size and resized size of every band, on this frame."""
    height, width = frame_shape[:2]
    for scale, top, bottom in search.bands:
        scale = scale * width / search.reference_size[0]
        top = round(top * height / search.reference_size[1])
        bottom = round(bottom * height / search.reference_size[1])
        resized = int(width / scale), int((bottom - top) / scale)
        yield scale, top, (round(resized[0] * scale), round(resized[1] * scale)), resized


def find_cars(frame, classifier, search):
    """Windows and decision values, each window scaled and classified alone."""
    params = classifier.params
    step = search.cells_per_step * params.pix_per_cell
    windows, scores = [], []
    for scale, top, (width, height), resized in bands(frame.shape, search):
        if min(resized) < params.window_size:
            continue
        band = cv2.resize(frame[top : top + height, :width], resized)
        for i, row in enumerate(band_features(band, params, search.cells_per_step)):
            for k, features in enumerate(row):
                scaled = classifier.scaler.transform(features[None])
                scores.append(classifier.svm.decision_function(scaled)[0])
                left, upper = k * step, i * step
                right, lower = left + params.window_size, upper + params.window_size
                windows.append(
                    (round(left * scale), round(upper * scale) + top,
                     round(right * scale), round(lower * scale) + top)
                )  # fmt: skip
    return np.array(windows), np.array(scores)


def heatmap_of(boxes, frame_shape):
    """Heat at full resolution."""
    heatmap = np.zeros(frame_shape[:2])
    for left, top, right, bottom in boxes:
        heatmap[top:bottom, left:right] += 1
    return heatmap


def lasting_heat(heatmaps, n_occ_thr):
    """G's filter at full resolution, one label after the other."""
    stack = np.array(heatmaps)
    labels, n_labels = label(stack)
    for k in range(1, n_labels + 1):
        region = labels == k
        if region.any(axis=(1, 2)).sum() < n_occ_thr:
            stack[region] = 0
    return stack.sum(axis=0)


def boxes_of(heatmap, threshold):
    """Boxes around the connected parts of the heat above a threshold."""
    labels, n_labels = label(np.where(heatmap > threshold, heatmap, 0))
    boxes = []
    for k in range(1, n_labels + 1):
        rows, columns = np.nonzero(labels == k)
        boxes.append((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))
    return np.array(boxes).reshape(-1, 4)


class Detector:
    """G's whole way: search, stack of full-size heatmaps, labels, boxes."""

    def __init__(self, classifier, search, heat_filter):
        self.classifier, self.search, self.filter = classifier, search, heat_filter
        self.heatmaps = []

    def detect(self, frame):
        """Boxes of the next frame of a video."""
        windows, scores = find_cars(frame, self.classifier, self.search)
        hot = windows[scores > self.search.threshold]
        self.heatmaps = [*self.heatmaps, heatmap_of(hot, frame.shape)][-self.filter.n_acc :]
        heat = lasting_heat(self.heatmaps, self.filter.n_occ_thr)
        return boxes_of(heat, self.filter.threshold)
