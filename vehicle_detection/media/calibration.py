"""Calibrate a camera from photos of a chessboard.

python -m vehicle_detection.media.calibration FOLDER --out output/calib.p
"""

from __future__ import annotations

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from tqdm.auto import tqdm

from vehicle_detection import command_line
from vehicle_detection.media import safe_pickle
from vehicle_detection.media.files import write_whole
from vehicle_detection.media.images import find_images, read_images
from vehicle_detection.parameters import DEFAULT_CALIBRATION, CalibrationParams

# More is a mistype; looking for so many takes for ever.
_MOST_CORNERS = 100
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


@dataclass(frozen=True)
class Fit:
    """A calibration, and how far it is to be believed.

    Attributes
    ----------
    calibration : Calibration
    error : float
        Root mean square reprojection error in pixels.
    deviations : dict of str to float
        Standard deviation of fx, fy, cx, cy in pixels, and of k1, k2, p1, p2, k3.
    skipped : list of Path
        Photos without the whole pattern, or of another size.
    """

    calibration: Calibration
    error: float
    deviations: dict
    skipped: list


_NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


def calibrate(
    paths: list, pattern: tuple = (9, 6), params: CalibrationParams = DEFAULT_CALIBRATION
) -> Fit:
    """Calibration from the photos that show the whole board, at the commonest size.

    Parameters
    ----------
    paths : list of Path
    pattern : (columns, rows)
        Inner corners.
    params : CalibrationParams

    Returns
    -------
    fit : Fit

    Raises
    ------
    ValueError
        Too few photos show the board, or all in about one pose: such a fit looks better than a
        good one, and is none [1]_.

    References
    ----------
    .. [1] Z. Zhang, "A Flexible New Technique for Camera Calibration", PAMI 2000.
    """
    columns, rows = pattern
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    corners, size, skipped = _boards(paths, pattern)
    folder = paths[0].parent
    if len(corners) < params.least_photos:
        raise ValueError(
            f"{folder}: {len(corners)} photos show all {columns}x{rows} inner "
            f"corners, at least {params.least_photos} are needed"
        )
    error, mtx, dist, turns, _, deviations, _, _ = cv2.calibrateCameraExtended(
        [board] * len(corners), corners, size, None, None
    )
    _require_spread(corners, size, turns, folder, params)
    return Fit(
        Calibration(mtx, dist.reshape(1, -1), size),
        error,
        dict(zip(_NAMES, deviations.ravel().tolist(), strict=False)),
        skipped,
    )


def _boards(paths, pattern):
    """Corners of every photo that shows the whole board, the size of the photos, the others."""
    images = read_images(paths)
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
    return corners, size, skipped


def _require_spread(corners, size, turns, folder, params):
    """Raise ValueError unless boards are tilted against each other and fill the picture."""
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])
    tilt = np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1))).max()
    hull = cv2.convexHull(np.concatenate(corners).reshape(-1, 2))
    coverage = cv2.contourArea(hull) / (size[0] * size[1])
    if tilt < params.least_tilt or coverage < params.least_coverage:
        raise ValueError(
            f"{folder}: the boards are tilted by {tilt:.0f} degrees against each other and cover "
            f"{coverage:.0%} of the picture; {params.least_tilt:.0f} degrees and "
            f"{params.least_coverage:.0%} are needed: take photos from more sides"
        )


def save_calibration(calibration: Calibration, path: str | os.PathLike) -> None:
    """Write `mtx`, `dist` and `image_size` as a pickled dict."""
    write_whole(path, safe_pickle.dumps(vars(calibration)))


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
    """Number of inner corners from the command line; a board has three a side or more."""
    count = int(text)
    if not 3 <= count <= _MOST_CORNERS:
        raise argparse.ArgumentTypeError(f"a board has 3 to {_MOST_CORNERS} inner corners a side")
    return count


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description="Calibrate a camera from chessboard photos.",
        epilog="example: %(prog)s photos --corners 9 6",
    )
    parser.add_argument("folder", type=Path, help="folder of photos, png or jpg")
    parser.add_argument(
        "--out", type=Path, default=Path("output/calib.p"), help="default: %(default)s"
    )
    parser.add_argument(
        "--corners", type=corner_count, nargs=2, default=(9, 6), metavar=("COLUMNS", "ROWS"),
        help="inner corners of the board, default: 9 6",
    )  # fmt: skip
    arguments = parser.parse_args()
    paths = find_images(arguments.folder)
    fit = calibrate(paths, tuple(arguments.corners))
    for path in fit.skipped:
        print(f"skipped, not all corners seen or of another size: {path}")
    mtx, dist = fit.calibration.mtx, fit.calibration.dist[0]
    values = mtx[0, 0], mtx[1, 1], mtx[0, 2], mtx[1, 2], *dist
    for (name, deviation), value in zip(fit.deviations.items(), values, strict=True):
        print(f"{name} {value:10.4f} +- {deviation:.4f}")
    print(f"reprojection error {fit.error:.3f} px over {len(paths) - len(fit.skipped)} photos")
    save_calibration(fit.calibration, arguments.out)
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    command_line.run(main)
