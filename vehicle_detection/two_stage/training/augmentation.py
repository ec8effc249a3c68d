"""Frames and images as other cameras might have taken them. Images are RGB, uint8."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from vehicle_detection.media.training_images import read_window
from vehicle_detection.parameters import DEFAULT_AUGMENTATION
from vehicle_detection.tracking.boxes import box_areas, clip_to_frame, touches_border

if TYPE_CHECKING:
    from vehicle_detection.parameters import AugmentationParams
    from vehicle_detection.two_stage.training.footage import Example

_IDENTITY_CURVE = np.linspace(0, 1, 256)


def random_camera(
    example: Example, rng: np.random.Generator, params: AugmentationParams = DEFAULT_AUGMENTATION
) -> tuple:
    """The frame as another camera might have taken it, with its boxes.

    Cut on any side, mirrored, smaller, blurred, of other exposure and colour, compressed:
    each with a chance of its own.

    Parameters
    ----------
    example : Example
    rng : numpy.random.Generator
    params : AugmentationParams

    Returns
    -------
    img : ndarray of uint8, shape (rows, columns, 3)
    boxes : ndarray of float, shape (n, 4)
    vehicles : ndarray of bool, shape (n,)
        The others are neither vehicles nor background.
    """
    img, boxes = example.read(), example.boxes
    at_border = touches_border(boxes, img.shape).any(axis=1)
    visibility = np.where(example.required | at_border, example.visibility, 0)
    if rng.random() < params.cut_chance:
        img, boxes, visibility = cut_frame(img, boxes, visibility, _random_cuts(rng, params))
    if rng.random() < 0.5:
        img, boxes = mirrored(img, boxes)
    if rng.random() < params.camera_chance:
        scale = _log_uniform(rng, params.scales) if rng.random() < params.scale_chance else 1
        img = cv2.resize(img, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        boxes = boxes * scale
        if rng.random() < params.blur_chance:
            img = cv2.GaussianBlur(img, (0, 0), rng.uniform(*params.blurs))
        img = random_exposure(img, rng, params)
        if rng.random() < params.jpeg_chance:
            img = compressed(img, rng.integers(*params.jpeg_qualities))
    boxes = clip_to_frame(boxes, img.shape)
    width, height = (boxes[:, 2:] - boxes[:, :2]).T
    seen = visibility >= params.least_visible
    vehicles = seen & (height >= params.least_height) & (width > params.least_aspect * height)
    return np.ascontiguousarray(img), boxes, vehicles


def _log_uniform(rng, limits):
    return float(np.exp(rng.uniform(*np.log(limits))))


def _random_cuts(rng, params):
    """Shares cut off at the left, top, right and bottom."""
    return rng.uniform(0, params.most_cut) * (rng.random(4) < params.side_chance)


def cut_frame(
    img: np.ndarray, boxes: np.ndarray, visibility: np.ndarray, cuts: np.ndarray
) -> tuple:
    """A frame without a share of each side, the boxes in it, and what is seen of each there.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
    boxes : ndarray of float, shape (n, 4)
    visibility : ndarray of float, shape (n,)
    cuts : ndarray of float, shape (4,)
        Shares cut off at the left, top, right and bottom.

    Returns
    -------
    img, boxes, visibility
        As above, for the part of the frame that is left.
    """
    rows, columns = img.shape[:2]
    left, top, right, bottom = (cuts * (columns, rows, columns, rows)).astype(int)
    right, bottom = columns - right, rows - bottom
    corner = np.array([left, top, left, top])
    inside = clip_to_frame(boxes - corner, (bottom - top, right - left))
    left_over = box_areas(inside) / np.maximum(box_areas(boxes), 1e-9)
    seen = left_over > 0
    return img[top:bottom, left:right], inside[seen], (visibility * left_over)[seen]


def mirrored(img: np.ndarray, boxes: np.ndarray) -> tuple:
    """Left and right exchanged."""
    columns = img.shape[1]
    left, top, right, bottom = boxes.T
    return img[:, ::-1], np.stack([columns - right, top, columns - left, bottom], axis=1)


def random_exposure(
    img: np.ndarray, rng: np.random.Generator, params: Any = DEFAULT_AUGMENTATION
) -> np.ndarray:
    """Other gain, gamma, haze, white balance and saturation."""
    if rng.random() >= params.exposure_chance:
        return img
    gain = np.exp(rng.normal(0, params.white_balance, 3) + rng.normal(0, params.gain))
    gamma = np.exp(rng.normal(0, params.gamma))
    haze = rng.uniform(0, params.haze) * (rng.random() < params.haze_chance)
    values = np.clip(gain * _IDENTITY_CURVE[:, None], 0, 1) ** gamma
    curve = 255 * (haze + (1 - haze) * values)
    img = cv2.LUT(np.ascontiguousarray(img), curve.astype(np.uint8)[None])
    if rng.random() < params.saturation_chance:
        gray = cv2.cvtColor(cv2.cvtColor(img, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        saturation = rng.uniform(*params.saturations)
        img = cv2.addWeighted(img, saturation, gray, 1 - saturation, 0)
    return img


def random_crop(
    path: str | os.PathLike, rng: np.random.Generator, params: Any = DEFAULT_AUGMENTATION
) -> np.ndarray:
    """An image of the training set as another camera might have taken it.

    Returns
    -------
    img : ndarray of uint8, shape (params.crop_side, params.crop_side, 3)
        RGB.
    """
    side = params.crop_side
    img, _ = read_window(path, side)
    if rng.random() < 0.5:
        img = img[:, ::-1]
    if rng.random() < params.scale_chance:
        small = int(side * _log_uniform(rng, params.crop_scales))
        img = cv2.resize(img, (small, small), interpolation=cv2.INTER_AREA)
    img = random_exposure(img, rng, params)
    return cv2.resize(img, (side, side), interpolation=cv2.INTER_LINEAR)


def degrade(
    patches: np.ndarray, rng: np.random.Generator, params: AugmentationParams = DEFAULT_AUGMENTATION
) -> np.ndarray:
    """Half of some patches as a worse camera might have shown them.

    Of fewer pixels, out of focus, compressed, in haze or in shade. A vehicle far away is so
    in any camera's picture, and most of those that are learned from are near.

    Parameters
    ----------
    patches : ndarray of uint8, shape (n, side, side, 3)
    rng : numpy.random.Generator
    params : AugmentationParams

    Returns
    -------
    patches : ndarray of uint8, shape (n, side, side, 3)
    """
    seen = patches.copy()
    for i in np.flatnonzero(rng.random(len(patches)) < params.degrade_chance):
        seen[i] = _degraded(patches[i], rng, params)
    return seen


def _degraded(patch, rng, params):
    size = patch.shape[1::-1]
    if rng.random() < params.shrink_chance:
        side = round(size[0] * _log_uniform(rng, params.shrinks))
        small = cv2.resize(patch, (side, side), interpolation=cv2.INTER_AREA)
        if rng.random() < params.blur_chance:
            small = cv2.GaussianBlur(small, (0, 0), rng.uniform(*params.blurs))
        if rng.random() < params.jpeg_chance:
            small = compressed(small, rng.integers(*params.jpeg_qualities))
        patch = cv2.resize(small, size, interpolation=cv2.INTER_LINEAR)
    if rng.random() < params.shade_chance:
        black = rng.uniform(0, params.most_black)
        white = rng.uniform(black + params.least_contrast, 255)
        gamma = np.exp(rng.normal(0, params.gamma))
        curve = black + (white - black) * _IDENTITY_CURVE**gamma
        patch = cv2.LUT(patch, curve.astype(np.uint8))
    return patch


def compressed(img: np.ndarray, quality: int) -> np.ndarray:
    """The image as JPEG of this quality, from 0 to 100, shows it."""
    encoded = cv2.imencode(".jpg", img, [cv2.IMWRITE_JPEG_QUALITY, int(quality)])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR))
