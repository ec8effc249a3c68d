"""Calibrate a camera from photos of a chessboard.

python -m vehicle_detection.media.calibration FOLDER --out output/calib.p
"""

from __future__ import annotations

import argparse
import os
import pickle
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from tqdm.auto import tqdm

from vehicle_detection.media import safe_pickle
from vehicle_detection.media.files import write_whole
from vehicle_detection.media.images import find_images, read_image

_THOROUGH = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


@dataclass(frozen=True)
class Calibration:
    """A camera, as OpenCV models it.

    Attributes
    ----------
    mtx : ndarray of float, shape (3, 3)
        Focal lengths and principal point, in pixels of `image_size`.
    dist : ndarray of float, shape (1, 5)
        Distortion k1, k2, p1, p2, k3.
    image_size : (width, height)
    """

    mtx: np.ndarray
    dist: np.ndarray
    image_size: tuple

    def maps(self, frame_shape: tuple) -> tuple:
        """Where each undistorted pixel of a frame comes from, for `cv2.remap`.

        Raises
        ------
        ValueError
            The frame has another aspect ratio than the calibration's photos.
        """
        height, width = frame_shape[:2]
        ratio = width / self.image_size[0]
        if abs(height - ratio * self.image_size[1]) > 1:
            raise ValueError(
                f"the calibration is of {self.image_size[0]}x{self.image_size[1]} photos "
                f"and does not fit frames of {width}x{height}"
            )
        mtx = self.mtx * [[ratio], [ratio], [1]]
        return cv2.initUndistortRectifyMap(mtx, self.dist, None, mtx, (width, height), cv2.CV_16SC2)

    def undistort(self, img: np.ndarray) -> np.ndarray:
        """An image as a pinhole camera would have seen it, of the same shape."""
        return cv2.remap(img, *self.maps(img.shape), cv2.INTER_LINEAR)


def find_corners(img: np.ndarray, pattern: tuple) -> np.ndarray | None:
    """Inner corners of a chessboard.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    pattern : (columns, rows)
        Inner corners.

    Returns
    -------
    corners : ndarray of float32, shape (columns * rows, 1, 2), or None
        x, y in pixels, to a fraction of a pixel; None if not all are seen.

    References
    ----------
    .. [1] A. Duda and U. Frese, "Accurate Detection and Localization of
           Checkerboard Corners for Calibration", BMVC 2018.
    """
    gray = cv2.cvtColor(img, cv2.COLOR_RGB2GRAY)
    found, corners = cv2.findChessboardCornersSB(gray, pattern, flags=_THOROUGH)
    return corners if found else None


def calibrate(paths: list, pattern: tuple = (9, 6)) -> tuple:
    """Calibration from the photos that show the whole board, at the commonest size.

    Parameters
    ----------
    paths : list of Path
    pattern : (columns, rows)
        Inner corners.

    Returns
    -------
    calibration : Calibration
    error : float
        Root mean square reprojection error in pixels.
    skipped : list of Path
        Photos without the whole pattern, or of another size.

    Raises
    ------
    ValueError
        Fewer than three photos show the board.
    """
    columns, rows = pattern
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    images = [read_image(path) for path in paths]
    size = Counter(img.shape[1::-1] for img in images).most_common(1)[0][0]
    corners, skipped = [], []
    for path, img in zip(tqdm(paths, desc="chessboards", unit="photo"), images, strict=True):
        found = None
        # A row or column more changes nothing, another resolution would.
        if np.abs(np.subtract(img.shape[1::-1], size)).max() <= 2:
            found = find_corners(img, pattern)
        if found is None:
            skipped.append(path)
        else:
            corners.append(found)
    if len(corners) < 3:
        raise ValueError(
            f"{paths[0].parent}: {len(corners)} photos show all {columns}x{rows} inner "
            "corners, at least 3 are needed"
        )
    error, mtx, dist, _, _ = cv2.calibrateCamera([board] * len(corners), corners, size, None, None)
    return Calibration(mtx, dist.reshape(1, -1), size), error, skipped


def save_calibration(calibration: Calibration, path: str | os.PathLike) -> None:
    """Write `mtx`, `dist` and `image_size` as a pickled dict."""
    write_whole(path, pickle.dumps(vars(calibration)))


def load_calibration(path: str | os.PathLike) -> Calibration:
    """Read what `save_calibration` wrote.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; it is no calibration, or one of impossible numbers.
    """
    path = Path(path)
    how = "make it anew, see docs/training.md"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such calibration: {how}")
    # What is no such file can fail in any way whatever.
    try:
        calibration = Calibration(**safe_pickle.loads(path.read_bytes()))
        mtx, dist, size = calibration.mtx, calibration.dist, calibration.image_size
        shapes = np.shape(mtx), np.shape(dist), np.shape(size)
        possible = np.isfinite(mtx).all() and np.isfinite(dist).all() and min(size) > 0
        possible = possible and mtx[0, 0] > 0 and mtx[1, 1] > 0
    except Exception as error:
        raise ValueError(f"{path}: not a calibration: {error}: {how}") from error
    if shapes != ((3, 3), (1, 5), (2,)) or not possible:
        raise ValueError(f"{path}: not a calibration: {how}")
    return calibration


def corner_count(text: str) -> int:
    """Number of inner corners from the command line; a board needs three a side."""
    count = int(text)
    if count < 3:
        raise argparse.ArgumentTypeError("a board needs three inner corners a side")
    return count


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description="Calibrate a camera from chessboard photos.")
    parser.add_argument("folder", type=Path, help="folder of photos, png or jpg")
    parser.add_argument(
        "--out", type=Path, default=Path("output/calib.p"), help="default: %(default)s"
    )
    parser.add_argument(
        "--corners", type=corner_count, nargs=2, default=(9, 6), metavar=("COLUMNS", "ROWS"),
        help="inner corners of the board, default: 9 6",
    )  # fmt: skip
    arguments = parser.parse_args()
    try:
        paths = find_images(arguments.folder)
        calibration, error, skipped = calibrate(paths, tuple(arguments.corners))
    except (OSError, ValueError) as failure:
        sys.exit(f"error: {failure}")
    for path in skipped:
        print(f"skipped, not all corners seen or of another size: {path}")
    mtx = calibration.mtx
    print(f"fx {mtx[0, 0]:.1f}  fy {mtx[1, 1]:.1f}  cx {mtx[0, 2]:.1f}  cy {mtx[1, 2]:.1f}")
    print("dist", *(f"{value:.4f}" for value in calibration.dist[0]))
    print(f"reprojection error {error:.3f} px over {len(paths) - len(skipped)} photos")
    try:
        save_calibration(calibration, arguments.out)
    except OSError as failure:
        sys.exit(f"error: {failure}")
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    main()
