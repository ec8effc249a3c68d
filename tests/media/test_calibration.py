"""Calibration against the camera that the photos were rendered with."""

import numpy as np
import pytest

from rendered_road.render import Camera
from rendered_road.sample import chessboard_photo
from vehicle_detection.media.calibration import calibrate, load_calibration, save_calibration
from vehicle_detection.media.images import find_images, write_image
from vehicle_detection.parameters import CalibrationParams


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards")
    for seed in range(8):
        write_image(folder / f"{seed}.png", chessboard_photo(seed))
    board_less = np.full((720, 1280, 3), 100, np.uint8)
    write_image(folder / "none.png", board_less)
    return find_images(folder)


def test_finds_the_camera_again(photos, tmp_path):
    fit = calibrate(photos)
    calibration, camera = fit.calibration, Camera()
    assert photos[-1] in fit.skipped
    assert fit.error < 0.1
    # Three standard deviations, by which the true camera may be off.
    for name, value, true in zip(
        ("fx", "fy", "cx", "cy"),
        calibration.mtx[[0, 1, 0, 1], [0, 1, 2, 2]],
        camera.mtx[[0, 1, 0, 1], [0, 1, 2, 2]],
        strict=True,
    ):
        assert abs(value - true) < 3 * fit.deviations[name] + 1
    np.testing.assert_allclose(calibration.mtx, camera.mtx, rtol=0.003, atol=1e-9)
    np.testing.assert_allclose(calibration.dist[0], camera.dist, atol=0.02)
    save_calibration(calibration, tmp_path / "calib.p")
    loaded = load_calibration(tmp_path / "calib.p")
    np.testing.assert_array_equal(loaded.mtx, calibration.mtx)
    assert loaded.image_size == (1280, 720)


def test_undistorted_lines_are_straight(photos):
    calibration = calibrate(photos).calibration
    map_x = calibration.maps((720, 1280, 3))[0][..., 0].astype(float)
    # A line at the left border of the pinhole picture is bowed in the raw one.
    assert abs(map_x[360, 60] - map_x[0, 60]) > 5
    half = calibration.maps((360, 640, 3))[0]
    whole = calibration.maps((720, 1280, 3))[0]
    np.testing.assert_allclose(half[180, 30] * 2, whole[360, 60], atol=3)


def test_other_aspect_ratio_is_refused(photos):
    calibration = calibrate(photos).calibration
    with pytest.raises(ValueError, match="1280x720 photos and does not fit frames of 640x480"):
        calibration.maps((480, 640, 3))


def test_too_few_boards_are_said(photos):
    with pytest.raises(ValueError, match="1 photos show all 9x6"):
        calibrate([photos[0], photos[-1]])


def test_boards_in_one_pose_are_refused(photos, tmp_path):
    for number in range(3):
        write_image(tmp_path / f"{number}.png", chessboard_photo(0))
    with pytest.raises(ValueError, match="tilted by 0 degrees"):
        calibrate(find_images(tmp_path))
    with pytest.raises(ValueError, match="cover .* of the picture"):
        calibrate(photos, params=CalibrationParams(least_coverage=0.99))


def test_wrong_calibration_file_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such calibration"):
        load_calibration(tmp_path / "calib.p")
    (tmp_path / "calib.p").write_bytes(b"text")
    with pytest.raises(ValueError, match="not a calibration"):
        load_calibration(tmp_path / "calib.p")
