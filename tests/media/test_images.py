"""Images of all sorts in, RGB out; bad files get an error that names them."""

import cv2
import numpy as np
import pytest

from conftest import textured_image
from vehicle_detection.media.files import write_whole, written_whole
from vehicle_detection.media.images import find_images, read_image, write_image


def test_read_image_gives_rgb(tmp_path):
    red = np.zeros((8, 8, 3), np.uint8)
    red[..., 0] = 200
    path = tmp_path / "red.png"
    write_image(path, red)
    np.testing.assert_array_equal(read_image(path), red)
    assert (cv2.imread(str(path))[0, 0] == (0, 0, 200)).all()


@pytest.mark.parametrize("kind", ["gray", "rgba", "16 bit", "jpeg"])
def test_read_image_takes_any_kind(tmp_path, kind):
    img = textured_image(0, 32, 32)
    path = tmp_path / ("img.jpg" if kind == "jpeg" else "img.png")
    stored = {
        "gray": cv2.cvtColor(img, cv2.COLOR_RGB2GRAY),
        "rgba": np.dstack([img[..., ::-1], np.full((32, 32), 90, np.uint8)]),
        "16 bit": img[..., ::-1].astype(np.uint16) * 257,
        "jpeg": img[..., ::-1],
    }[kind]
    assert cv2.imwrite(str(path), stored)
    loaded = read_image(path)
    assert loaded.shape == (32, 32, 3) and loaded.dtype == np.uint8
    if kind == "gray":
        np.testing.assert_array_equal(loaded, np.repeat(stored[..., None], 3, axis=2))
    elif kind != "jpeg":
        np.testing.assert_array_equal(loaded, img)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("keep", [0, 20, 0.5, 0.95])
def test_truncated_image_is_named(tmp_path, suffix, keep):
    path = tmp_path / f"cut{suffix}"
    write_image(path, textured_image(1, 64, 64))
    content = path.read_bytes()
    path.write_bytes(content[: keep if isinstance(keep, int) else int(len(content) * keep)])
    with pytest.raises(ValueError, match=f"cut{suffix}: .*replace or delete"):
        read_image(path)


def test_what_a_camera_writes_behind_a_jpeg_does_no_harm(tmp_path):
    path = tmp_path / "img.jpg"
    write_image(path, textured_image(1, 64, 64))
    expected = read_image(path)
    path.write_bytes(path.read_bytes() + b"trailer" * 50)
    np.testing.assert_array_equal(read_image(path), expected)


def test_missing_image_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.png: no such image"):
        read_image(tmp_path / "gone.png")


def test_find_images_at_any_depth(tmp_path):
    for name in ("b/deep/2.JPG", "a/1.png", "3.jpeg", "notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    names = [str(path.relative_to(tmp_path)) for path in find_images(tmp_path)]
    assert names == ["3.jpeg", "a/1.png", "b/deep/2.JPG"]


def test_find_images_says_what_is_wrong(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere: no such folder"):
        find_images(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match="no png or jpg images"):
        find_images(tmp_path)


def test_nothing_half_written_is_left(tmp_path):
    path = tmp_path / "new" / "result.txt"
    with pytest.raises(RuntimeError), written_whole(path) as partial:
        partial.write_text("half")
        raise RuntimeError
    assert list(path.parent.iterdir()) == []
    write_whole(path, "whole")
    write_whole(path, b"whole again")
    assert [p.name for p in path.parent.iterdir()] == ["result.txt"]
    assert path.read_text() == "whole again"
