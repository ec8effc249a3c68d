"""Boxes, heat and titles drawn on copies of a frame. Images and colours are RGB."""

from __future__ import annotations

from colorsys import hsv_to_rgb

import cv2
import numpy as np

# Colours that colour-blind people tell apart [1]_: of boxes in general, of what passes a
# threshold, of what does not, and of the truth.
#
# .. [1] M. Okabe and K. Ito, "Color Universal Design", 2008.
BLUE, GREEN, VERMILLION, WHITE = (0, 0, 255), (0, 158, 115), (213, 94, 0), (255, 255, 255)


def draw_boxes(
    img: np.ndarray, boxes: np.ndarray, color: tuple = BLUE, thickness: int = 4
) -> np.ndarray:
    """A copy of the image with boxes on it.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of int, shape (n, 4)
    color : tuple of int
        RGB.
    thickness : int
        In pixels.
    """
    img = img.copy()
    for left, top, right, bottom in np.asarray(boxes, int).reshape(-1, 4).tolist():
        cv2.rectangle(img, (left, top), (right - 1, bottom - 1), color, thickness)
    return img


def identity_color(identity: int) -> tuple:
    """A bright RGB colour for a vehicle's number, far from those of its neighbours."""
    # Steps of the golden ratio around the circle of hues stay far from all recent ones.
    hue = identity * 0.6180339887 % 1
    return tuple(round(255 * value) for value in hsv_to_rgb(hue, 0.85, 1.0))


def draw_vehicles(
    img: np.ndarray,
    boxes: np.ndarray,
    ids: np.ndarray,
    thickness: int = 4,
    metres: np.ndarray | None = None,
) -> np.ndarray:
    """A copy of the image with every vehicle boxed and numbered in the colour of its identity.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of int, shape (n, 4)
    ids : ndarray of int, shape (n,)
    thickness : int
        In pixels.
    metres : ndarray of float, shape (n,), optional
        Distance of each, written below it unless it is NaN.
    """
    img = img.copy()
    font_scale = img.shape[0] / 600
    font = cv2.FONT_HERSHEY_SIMPLEX
    known = np.full(len(ids), np.nan) if metres is None else metres
    rows = zip(boxes.tolist(), ids.tolist(), known.tolist(), strict=True)
    for (left, top, right, bottom), identity, distance in rows:
        color = identity_color(identity)
        cv2.rectangle(img, (left, top), (right - 1, bottom - 1), color, thickness)
        # Above the box, or inside it where that would leave the picture.
        place = left, max(top - 2 * thickness, round(22 * font_scale))
        cv2.putText(img, str(identity), place, font, font_scale, color, 2, cv2.LINE_AA)
        if distance == distance:
            below = left, bottom + round(14 * font_scale)
            text, scale = f"{distance:.0f} m", 0.5 * font_scale
            cv2.putText(img, text, below, font, scale, color, 1, cv2.LINE_AA)
    return img


def draw_rated(
    img: np.ndarray, boxes: np.ndarray, values: np.ndarray, threshold: float
) -> np.ndarray:
    """Boxes with a number each: green from the threshold on, vermillion below.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray, shape (n, 4)
    values : ndarray of float, shape (n,)
    threshold : float
    """
    img = img.copy()
    font_scale = img.shape[0] / 900
    for (left, top, right, bottom), value in zip(boxes.round().astype(int), values, strict=True):
        color = GREEN if value >= threshold else VERMILLION
        cv2.rectangle(img, (left, top), (right - 1, bottom - 1), color, 2)
        place = left, max(top - 4, round(20 * font_scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(img, f"{value:.1f}", place, font, font_scale, color, 2, cv2.LINE_AA)
    return img


def draw_heat(img: np.ndarray, heatmap: np.ndarray, full_scale: float) -> np.ndarray:
    """The image darkened, with heat glowing on it.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    heatmap : ndarray, shape (rows, columns)
    full_scale : float
        Heat that is drawn at its brightest.
    """
    level = np.clip(255 * heatmap / full_scale, 0, 255).astype(np.uint8)
    glow = cv2.applyColorMap(level, cv2.COLORMAP_HOT)[..., ::-1]
    return cv2.addWeighted(img, 0.4, glow, 0.9, 0)


def draw_title(img: np.ndarray, title: str) -> np.ndarray:
    """The image with a line of text at its top left."""
    size = img.shape[0] / 500
    place = round(20 * size), round(30 * size)
    for color, shift in (((0, 0, 0), 1), ((255, 255, 255), 0)):
        where = place[0] + shift, place[1] + shift
        img = cv2.putText(img, title, where, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)
    return img
