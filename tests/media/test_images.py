"""Images of all sorts in, RGB out; bad files get an error that names them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import CASES, textured_image
from vehicle_detection.media.images import (
    find_images,
    image_format,
    natural_order,
    read_image,
    read_images,
    write_image,
)


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
    with pytest.raises(FileNotFoundError, match="no images in it"):
        find_images(tmp_path)


def test_left_overs_are_no_images(tmp_path):
    for name in (".hidden.jpg", "._IMG_1.jpg", ".folder/1.jpg", "1.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "x.png").mkdir()
    assert [path.name for path in find_images(tmp_path)] == ["1.jpg"]


@given(numbers=st.lists(st.integers(0, 10**6), min_size=2, max_size=6, unique=True))
def test_numbers_in_names_are_numbers(numbers):
    names = [Path(f"drive 2/frame{number}.jpg") for number in numbers]
    ordered = sorted(names, key=natural_order)
    assert ordered == [Path(f"drive 2/frame{number}.jpg") for number in sorted(numbers)]


def test_order_of_numbers_and_words():
    names = ["b1", "a10", "a2", "a", "A2", "a2b", "10", "9"]
    ordered = [str(p) for p in sorted(map(Path, names), key=natural_order)]
    assert ordered.index("a2") < ordered.index("a10") and ordered.index("9") < ordered.index("10")


@pytest.mark.parametrize("suffix", [".bmp", ".webp", ".tif", ".png", ".jpg"])
def test_what_a_file_is_its_content_says(tmp_path, suffix):
    img = textured_image(0, 48, 64)
    write_image(tmp_path / f"img{suffix}", img)
    path = (tmp_path / f"img{suffix}").rename(tmp_path / "img.dat")
    with open(path, "rb") as file:
        assert image_format(file)
    difference = np.abs(read_image(path).astype(int) - img).mean()
    assert difference == 0 if suffix in (".bmp", ".tif", ".png") else difference < 20


def test_a_motion_photo_is_whole():
    assert read_image(CASES / "motion_photo.jpg").shape == (180, 320, 3)


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.99])
def test_a_truncated_jpeg_is_said(tmp_path, progressive, share):
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_RST_INTERVAL, 4]
    whole = cv2.imencode(".jpg", textured_image(0, 96, 128), options)[1].tobytes()
    path = tmp_path / "photo.jpg"
    # A thumbnail with an end of its own, fill bytes, and what some cameras write behind.
    thumbnail = b"\xff\xe1" + (2 + 6).to_bytes(2) + b"\xff\xda\x00\x00\xff\xd9"
    path.write_bytes(whole[:2] + thumbnail + b"\xff" + whole[2:] + b"\xff\xda trailer")
    assert read_image(path).shape == (96, 128, 3)
    path.write_bytes(whole[:2] + thumbnail + whole[2 : int(len(whole) * share)])
    with pytest.raises(ValueError, match=r"photo\.jpg: (truncated|not a readable image)"):
        read_image(path)


def test_a_huge_claim_is_refused():
    with pytest.raises(ValueError, match=r"png_claim_65000\.png: too large"):
        read_image(CASES / "png_claim_65000.png")


def test_all_bad_images_are_named(tmp_path):
    write_image(tmp_path / "good.png", textured_image(0, 8, 8))
    (tmp_path / "text.png").write_text("text")
    paths = [tmp_path / name for name in ("good.png", "text.png", "gone.png")]
    with pytest.raises(ValueError, match=r"text\.png: not a readable(.|\n)*gone\.png: no such"):
        read_images(paths)
    assert len(read_images(paths[:1])) == 1


@given(
    content=st.binary(max_size=300),
    kind=st.sampled_from([b"", b"\xff\xd8\xff", b"\x89PNG\r\n", b"BM", b"II*\0"]),
)
def test_no_content_breaks_the_reader(tmp_path_factory, content, kind):
    path = tmp_path_factory.getbasetemp() / "fuzzed.jpg"
    path.write_bytes(kind + content)
    try:
        img = read_image(path)
    except ValueError as error:
        assert "fuzzed.jpg: " in str(error)
    else:
        assert img.dtype == np.uint8 and img.ndim == 3
