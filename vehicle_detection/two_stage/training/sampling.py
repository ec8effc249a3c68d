"""What is learned from: vehicles with moved edges, parts of vehicles, what lies beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vehicle_detection.tracking.boxes import (
    best_iou,
    box_areas,
    move_edges,
    pairwise_iou,
    pairwise_overlap,
)

# Of the edges of a box, in widths and heights: how far a proposal may be off.
_PROPOSAL_JITTERS = (0.04, 0.1, 0.1)
_LEAST_PART = 0.3
_FARTHEST_NEIGHBOUR = 1.5
_MOST_CUT = 0.55


@dataclass(frozen=True)
class PatchSamples:
    """Patches to learn from.

    Attributes
    ----------
    features : ndarray of float16, shape (n, N_FEATURES)
    labels : ndarray of int, shape (n,)
        1 for vehicles, 0 for background, -1 for what is neither for certain.
    shifts : ndarray of float, shape (n, 4)
        From each box to the edges of its vehicle, in widths and heights of the box; not a
        number for a box without.
    """

    features: np.ndarray
    labels: np.ndarray
    shifts: np.ndarray

    def only(self, chosen: np.ndarray) -> PatchSamples:
        """The samples that a mask or index array picks."""
        return PatchSamples(self.features[chosen], self.labels[chosen], self.shifts[chosen])


def joined(samples: list) -> PatchSamples:
    """Samples of many frames as one."""
    names = "features", "labels", "shifts"
    return PatchSamples(*(np.concatenate([getattr(s, n) for s in samples]) for n in names))


def jittered(boxes: np.ndarray, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Boxes with every edge moved at random by about `spread` of the size."""
    shifts = np.clip(rng.normal(0, spread, boxes.shape), -2 * spread, 2 * spread)
    return move_edges(boxes, shifts)


def with_moved_edges(boxes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Each box three times, its edges moved at random, once by little."""
    return np.concatenate([jittered(boxes, spread, rng) for spread in _PROPOSAL_JITTERS])


def random_parts(boxes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A part of each box, three tenths to all of its width and height."""
    size = boxes[:, 2:] - boxes[:, :2]
    part = size * rng.uniform(_LEAST_PART, 1, size.shape)
    corner = boxes[:, :2] + (size - part) * rng.uniform(0, 1, size.shape)
    return np.hstack([corner, corner + part])


def neighbours(boxes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A place on or around each box, where tracks that go astray end up."""
    size = boxes[:, 2:] - boxes[:, :2]
    aside = size * rng.uniform(-_FARTHEST_NEIGHBOUR, _FARTHEST_NEIGHBOUR, size.shape)
    return boxes + np.hstack([aside, aside])


def edge_shifts(boxes: np.ndarray, vehicles: np.ndarray, least_iou: float) -> np.ndarray:
    """From every box to the edges of the vehicle that it overlaps most.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    vehicles : ndarray of float, shape (m, 4)
    least_iou : float
        A box belongs to no vehicle below it.

    Returns
    -------
    shifts : ndarray of float, shape (n, 4)
        In widths and heights of the box; not a number for a box that belongs to none.
    """
    shifts = np.full((len(boxes), 4), np.nan)
    if len(boxes) and len(vehicles):
        iou = pairwise_iou(boxes, vehicles)
        near = iou.max(axis=1) > least_iou
        own, size = vehicles[iou.argmax(axis=1)], np.tile(boxes[:, 2:] - boxes[:, :2], 2)
        shifts[near] = ((own - boxes) / size)[near]
    return shifts


def windows_around(
    boxes: np.ndarray, shape: float, jitter: float, rng: np.random.Generator
) -> np.ndarray:
    """Windows of one shape as large as boxes and where these are, their edges moved at random.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    shape : float
        Width by height.
    jitter : float
        Standard deviation, in widths and heights.
    rng : numpy.random.Generator

    Returns
    -------
    windows : ndarray of float, shape (n, 4)
    """
    middle = (boxes[:, :2] + boxes[:, 2:]) / 2
    height = np.sqrt(box_areas(boxes) / shape)
    half = np.stack([height * shape, height], axis=1) / 2
    return jittered(np.hstack([middle - half, middle + half]), jitter, rng)


def is_background(windows: np.ndarray, boxes: np.ndarray, iou: float, covered: float) -> np.ndarray:
    """Which windows overlap every box by less than an IoU and by less than a share of theirs."""
    if not len(boxes):
        return np.ones(len(windows), bool)
    share = pairwise_overlap(windows, boxes) / box_areas(windows)[:, None]
    return (best_iou(windows, boxes) < iou) & (share.max(axis=1) < covered)


def cut_by_border(box: np.ndarray, rng: np.random.Generator) -> tuple:
    """What is left of a box that a border of the frame cuts, on a side at random.

    Parameters
    ----------
    box : ndarray of float, shape (4,)
    rng : numpy.random.Generator

    Returns
    -------
    box : ndarray of float, shape (4,)
    outside : ndarray of float, shape (4,)
        See `features.margins_outside`.
    """
    side = rng.integers(4)
    box, outside = box.copy(), np.zeros(4)
    box[side] += rng.uniform(0, _MOST_CUT) * (box[(side + 2) % 4] - box[side])
    outside[side] = 1
    return box, outside
