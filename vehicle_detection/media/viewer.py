"""What both ways of detecting do with the frames of a video, apart from detecting."""

import cv2
import numpy as np

from pipeline_functions import draw_vehicles
from vehicle_detection.compiled.threads import share
from vehicle_detection.media import calibration as calibrate

_ROWS_WORTH_A_THREAD = 100


class Viewer:
    """Draws the vehicles of the frames of one video, handed over in order.

    A class on top of this one finds them: it has `detect`, which takes a frame
    and returns what it found, with boxes and ids, and `step_pictures`.

    Parameters
    ----------
    path_calib : path or None
        Calibration of `calibrate.py`; None draws on the frame as it is.

    Attributes
    ----------
    titles : tuple of str
        Of the four `step_pictures`.
    """

    titles = ()

    def __init__(self, path_calib):
        self.calibration = None
        if path_calib is not None:
            self.load_calibration(path_calib)

    def load_calibration(self, path):
        """Read a calibration, see `calibrate.load_calibration`."""
        self.calibration = calibrate.load_calibration(path)
        self._maps = {}

    def reset(self):
        """Forget all frames: the next one begins another video."""
        self._frame_shape = None
        self._n_frames = 0

    def _require_same_size(self, rgb_frame):
        if self._frame_shape not in (None, rgb_frame.shape):
            raise ValueError(f"a frame of {rgb_frame.shape} after one of {self._frame_shape}")
        self._frame_shape = rgb_frame.shape

    def process_image(self, rgb_frame):
        """The next frame of the video, its vehicles boxed in colours of their own.

        Parameters
        ----------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)

        Returns
        -------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)
            Undistorted if there is a calibration.
        """
        return self.draw(rgb_frame, self.detect(rgb_frame))

    def draw(self, rgb_frame, detections):
        """Vehicles on the frame, then undistortion if there is a calibration."""
        return self.undistort(draw_vehicles(rgb_frame, detections.boxes, detections.ids))

    def draw_split_screen(self, rgb_frame, detections):
        """The four of `step_pictures` in one picture as large as the frame.

        Returns
        -------
        picture : ndarray of uint8, shape (rows, columns, 3)
        """
        rows, columns = rgb_frame.shape[:2]
        picture = np.zeros_like(rgb_frame)
        quarter = columns // 2, rows // 2
        for i, step in enumerate(self.step_pictures(rgb_frame, detections)):
            tile = draw_title(
                cv2.resize(step, quarter, interpolation=cv2.INTER_AREA), self.titles[i]
            )
            top, left = i // 2 * quarter[1], i % 2 * quarter[0]
            picture[top : top + quarter[1], left : left + quarter[0]] = tile
        return picture

    def undistort(self, rgb_frame):
        """The frame as a pinhole camera would see it; as it is without calibration."""
        if self.calibration is None:
            return rgb_frame
        if rgb_frame.shape not in self._maps:
            self._maps[rgb_frame.shape] = self.calibration.maps(rgb_frame.shape)
        places, fractions = self._maps[rgb_frame.shape]
        picture = np.empty(rgb_frame.shape, np.uint8)

        def fill(first, last):
            """Some rows of the picture."""
            maps = places[first:last], fractions[first:last]
            cv2.remap(rgb_frame, *maps, cv2.INTER_LINEAR, dst=picture[first:last])

        share(fill, len(picture), len(picture) // _ROWS_WORTH_A_THREAD)
        return picture


def draw_title(img, title):
    """The image with a line of text at its top left."""
    size = img.shape[0] / 500
    place = round(20 * size), round(30 * size)
    for color, shift in (((0, 0, 0), 1), ((255, 255, 255), 0)):
        where = place[0] + shift, place[1] + shift
        img = cv2.putText(img, title, where, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)
    return img
