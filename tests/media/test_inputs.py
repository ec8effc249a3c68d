"""What a command line names, and where the results go."""

from pathlib import Path

import pytest
from PIL import Image

from conftest import moving_frames, textured_image, write_video
from vehicle_detection.media.images import write_image
from vehicle_detection.media.inputs import gather_inputs, require_free_outputs, require_no_input


@pytest.fixture
def folder(tmp_path):
    """Images and videos at several depths, and what is neither."""
    drive = tmp_path / "drive"
    for name in ("10.png", "2.png", "front/1.jpg", "rear/1.jpg"):
        write_image(drive / name, textured_image(0, 80, 96))
    clip = write_video(drive / "clip.mp4", moving_frames(3))
    clip.rename(drive / "clip")
    write_video(drive / "2.mp4", moving_frames(3))
    (drive / "notes.txt").write_text("no picture")
    (drive / "._2.png").write_bytes(b"macOS")
    (drive / "broken.mp4").write_bytes(b"no video")
    return drive


def test_folders_are_searched_in_natural_order(folder, tmp_path):
    sources = gather_inputs([folder], tmp_path / "out")
    names = [source.path.relative_to(folder).as_posix() for source in sources]
    assert names == [
        "2.mp4", "2.png", "10.png", "broken.mp4", "clip", "front/1.jpg", "rear/1.jpg",
    ]  # fmt: skip
    assert [source.is_video for source in sources] == [True, False, False, True, True, False, False]


def test_every_input_has_outputs_of_its_own(folder, tmp_path):
    sources = gather_inputs([folder, folder / "front", folder / "rear"], tmp_path / "out")
    outputs = [output for source in sources for output in source.outputs]
    assert len(set(outputs)) == len(outputs)
    names = {p.relative_to(tmp_path / "out").as_posix() for p in outputs}
    assert {"front/1.txt", "rear/1.txt", "1.txt", "1_2.txt", "2.txt", "2_2.txt"} <= names


def test_a_folder_above_the_results_is_searched(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    assert len(gather_inputs([Path("drive")], Path("."))) == 7
    assert len(gather_inputs([Path("drive/front")], Path("drive"))) == 1


def test_a_header_may_be_long(tmp_path):
    """An image without a suffix, whose size stands behind 150 kB of other things."""
    image = Image.fromarray(textured_image(0, 80, 96))
    image.save(tmp_path / "photo.jpg", icc_profile=bytes(150_000))
    (tmp_path / "photo.jpg").rename(tmp_path / "photo")
    (source,) = gather_inputs([tmp_path / "photo"], tmp_path / "out")
    assert not source.is_video


def test_case_alone_makes_no_other_name(tmp_path):
    for name in ("a/Drive.png", "b/drive.png"):
        write_image(tmp_path / name, textured_image(0, 80, 96))
    first, second = gather_inputs([tmp_path / "a", tmp_path / "b"], tmp_path / "out")
    assert second.picture.name == "drive_2.png"


def test_results_within_a_folder_are_no_inputs(folder):
    write_image(folder / "out/1.png", textured_image(0, 80, 96))
    paths = [source.path for source in gather_inputs([folder], folder / "out")]
    assert folder / "out/1.png" not in paths and len(paths) == 7


def test_nothing_is_replaced_unless_allowed(folder, tmp_path):
    sources = gather_inputs([folder / "2.png"], tmp_path / "out")
    require_free_outputs(sources, overwrite=False)
    write_image(tmp_path / "out/2.png", textured_image(0, 80, 96))
    with pytest.raises(FileExistsError, match=r"2\.png is there already"):
        require_free_outputs(sources, overwrite=False)
    require_free_outputs(sources, overwrite=True)
    for where in (folder, folder / "front/.."):
        with pytest.raises(FileExistsError, match="is an input"):
            require_no_input(gather_inputs([folder / "2.png"], where))


def test_bad_inputs_are_named(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.mp4: no such file"):
        gather_inputs([folder / "gone.mp4"], tmp_path / "out")
    with pytest.raises(ValueError, match=r"notes\.txt: neither an image nor a video"):
        gather_inputs([folder / "notes.txt"], tmp_path / "out")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="empty: no images or videos"):
        gather_inputs([tmp_path / "empty"], tmp_path / "out")
    with pytest.raises(ValueError, match="null: is no regular file"):
        gather_inputs(["/dev/null"], tmp_path / "out")


def test_what_cannot_be_read_or_named_stops_no_other(folder, tmp_path):
    (folder / "loop").symlink_to("loop")
    (folder / "empty.mp4").touch()
    (folder / ("x" * 248 + ".mp4")).write_bytes(b"no video")
    sources = gather_inputs([folder], tmp_path / "out")
    assert len(sources) == 9
    require_free_outputs(sources, overwrite=False)


def test_what_is_read_beside_the_inputs_is_kept(folder):
    sources = gather_inputs([folder / "2.png"], folder / "results")
    with pytest.raises(FileExistsError, match="is an input"):
        require_no_input(sources, [None, folder / "results/2.txt"])
