"""HOTA: how well vehicles are found and kept apart, both with the same weight.

References
----------
.. [1] J. Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking",
       IJCV 2021.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from vehicle_detection.tracking.boxes import pairwise_iou

if TYPE_CHECKING:
    from vehicle_detection.media.mot import Rows

# Localisation thresholds of the definition.
_ALPHAS = np.arange(1, 20) / 20


def hota(truth: Rows, detections: Rows) -> float | None:
    """Mean over the thresholds of the root of detection times association accuracy.

    Parameters
    ----------
    truth, detections : Rows
        Required vehicles; detections that count; both with identities.

    Returns
    -------
    hota : float or None
        From 0 to 1; None if there is nothing to find.
    """
    if not len(truth.ids):
        return None
    if not len(detections.ids):
        return 0.0
    frames = list(_by_frame(truth, detections))
    n_truth, n_found = (np.unique(rows.ids, return_counts=True)[1] for rows in (truth, detections))
    together = np.zeros((len(n_truth), len(n_found)))
    for own, found, iou in frames:
        shared = iou.sum(axis=0) + iou.sum(axis=1)[:, None] - iou
        together[np.ix_(own, found)] += np.divide(iou, shared, np.zeros_like(iou), where=shared > 0)
    # Matching prefers pairs that belong together in the whole video.
    alignment = together / (n_truth[:, None] + n_found - together)
    matches = np.zeros((len(_ALPHAS), *together.shape))
    for own, found, iou in frames:
        pairs = linear_sum_assignment(alignment[np.ix_(own, found)] * iou, maximize=True)
        for row, column in zip(*pairs, strict=True):
            matches[iou[row, column] >= _ALPHAS - 1e-9, own[row], found[column]] += 1
    n_matches = matches.sum(axis=(1, 2))
    detection = n_matches / (len(truth.ids) + len(detections.ids) - n_matches)
    kept = matches / (n_truth[:, None] + n_found - matches)
    association = (matches * kept).sum(axis=(1, 2)) / np.maximum(1, n_matches)
    return float(np.sqrt(detection * association).mean())


def _by_frame(truth, detections):
    """Yield places of the identities among all of them, and IoU, of every frame with both."""
    places = [np.unique(rows.ids, return_inverse=True)[1] for rows in (truth, detections)]
    for frame in np.intersect1d(truth.frames, detections.frames):
        here = [rows.frames == frame for rows in (truth, detections)]
        iou = pairwise_iou(truth.boxes[here[0]], detections.boxes[here[1]])
        yield places[0][here[0]], places[1][here[1]], iou
