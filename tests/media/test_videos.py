"""Videos in and out: what is kept, what is lost and said, what is refused."""

import threading
import time
from fractions import Fraction
from itertools import pairwise

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import CASES, moving_frames, textured_image, write_video
from vehicle_detection.media.encoder import encoding, video_writer
from vehicle_detection.media.timeline import Timeline
from vehicle_detection.media.videos import (
    VideoInfo,
    VideoReader,
    is_video,
    read_frames,
    video_info,
)


def encoded(path, frames, codec="libx264", rate=25, rotation=None, sound=None, **context):
    """A video as another program would have written it; `context` is set on the encoder."""
    with av.open(str(path), "w") as output:
        frames = list(frames)
        stream = output.add_stream(codec, rate=rate)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for name, value in context.items():
            setattr(stream.codec_context, name, value)
        tone = output.add_stream(sound, rate=16_000, layout="mono") if sound else None
        for frame in frames:
            output.mux(stream.encode(av.VideoFrame.from_ndarray(frame, "rgb24")))
        output.mux(stream.encode(None))
        if tone:
            wave = (8000 * np.sin(np.arange(16_000) / 6)).astype(np.int16)[None]
            samples = av.AudioFrame.from_ndarray(wave, "s16", "mono")
            samples.rate, samples.pts = 16_000, 0
            for part in av.AudioResampler(tone.format, tone.layout, tone.rate).resample(samples):
                output.mux(tone.encode(part))
            output.mux(tone.encode(None))
    return path


def copied(source, path, **options):
    """A video decoded and encoded, frame by frame; the reader."""
    reader = VideoReader(source)
    with video_writer(path, reader.info, source=source, **options) as write:
        for frame in reader:
            write(frame.rgb, frame.time)
    return reader


def seconds(path):
    """The time of every frame."""
    reader = VideoReader(path)
    return [float(frame.time * reader.info.time_base) for frame in reader]


@pytest.mark.parametrize(("rows", "columns"), [(180, 320), (181, 321)])
def test_video_comes_back_in_rgb(tmp_path, rows, columns):
    path = write_video(tmp_path / "clip.mp4", moving_frames(12, rows, columns))
    info = video_info(path)
    assert (info.width, info.height) == (columns + columns % 2, rows + rows % 2)
    assert (info.fps, info.n_frames) == (25, 12)
    back = list(read_frames(path))
    assert len(back) == 12
    patch = back[3][120:140, 70:100].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(patch, (250, 240, 60), atol=12)
    # Every player shows luma with a colour sample for two by two pixels.
    with av.open(str(path)) as container:
        assert container.streams.video[0].pix_fmt == "yuv420p"


@pytest.mark.parametrize("shape", [(48, 64), (49, 64), (50, 65), (51, 66), (270, 480)])
def test_whole_pictures_come_back(tmp_path, shape):
    coarse = np.random.default_rng(0).integers(0, 256, (4, 5, 3), np.uint8)
    img = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    with video_writer(tmp_path / "clip.mp4", VideoInfo(*shape[::-1], 25, 3), "medium") as write:
        for _ in range(3):
            write(img)
    for back in read_frames(tmp_path / "clip.mp4"):
        difference = np.abs(back[: shape[0], : shape[1]] - img.astype(int))
        assert difference.mean() < 8


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (2, 64), (64, 2)])
def test_the_smallest_pictures_are_written(tmp_path, rows, columns):
    path = write_video(tmp_path / "clip.mp4", [np.full((rows, columns, 3), 90, np.uint8)] * 2)
    assert len(list(read_frames(path))) == 2


def test_what_is_needed_to_play_comes_first(tmp_path):
    content = write_video(tmp_path / "clip.mp4", moving_frames(12)).read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")


def test_reader_can_be_left_early(tmp_path):
    path = write_video(tmp_path / "clip.mp4", moving_frames(60))
    before = threading.active_count()
    frames = read_frames(path)
    next(frames)
    frames.close()
    assert threading.active_count() == before


# ----------------------------------------------------------------- what is kept


@pytest.mark.parametrize("name", ["variable_rate.mp4", "trimmed.mp4", "gps_track.mp4", "av1.mp4"])
def test_every_frame_keeps_its_time(tmp_path, name):
    reader = copied(CASES / name, tmp_path / "copy.mp4")
    assert reader.lost == []
    np.testing.assert_allclose(seconds(tmp_path / "copy.mp4"), seconds(CASES / name), atol=1e-3)


def test_variable_rate_is_no_constant_one():
    steps = np.diff(seconds(CASES / "variable_rate.mp4"))
    assert steps.max() > 1.5 * steps.min()


def packets(path, kind):
    with av.open(str(path)) as container:
        stream = next(s for s in container.streams if s.type == kind)
        found = [(float(p.pts * p.time_base), bytes(p)) for p in container.demux(stream) if p.size]
        return stream.codec_context.name, found


def test_sound_and_subtitles_are_copied(tmp_path):
    copied(CASES / "sound.mp4", tmp_path / "copy.mp4")
    name, expected = packets(CASES / "sound.mp4", "audio")
    assert packets(tmp_path / "copy.mp4", "audio")[0] == name == "aac"
    found = packets(tmp_path / "copy.mp4", "audio")[1]
    assert [content for _, content in found] == [content for _, content in expected]
    np.testing.assert_allclose([t for t, _ in found], [t for t, _ in expected], atol=0.05)
    copied(CASES / "gps_track.mp4", tmp_path / "track.mp4")
    texts = [content for _, content in packets(CASES / "gps_track.mp4", "subtitle")[1]]
    assert [c for _, c in packets(tmp_path / "track.mp4", "subtitle")[1]] == texts


def test_sound_that_mp4_cannot_hold_becomes_aac(tmp_path):
    source = encoded(tmp_path / "clip.avi", moving_frames(25), "mjpeg", sound="pcm_s16le")
    copied(source, tmp_path / "copy.mp4")
    name, found = packets(tmp_path / "copy.mp4", "audio")
    assert name == "aac" and 0.9 < found[-1][0] < 1.1


def test_metadata_are_kept(tmp_path):
    copied(CASES / "gps_track.mp4", tmp_path / "copy.mp4")
    before, after = (
        video_info(p).metadata for p in (CASES / "gps_track.mp4", tmp_path / "copy.mp4")
    )
    for name in ("creation_time", "location"):
        assert after[name] == before[name]


@pytest.mark.parametrize("matrix", [1, 4, 5, 6, 7, 9])
def test_colours_and_their_tags_are_kept(tmp_path, matrix):
    frame = np.zeros((96, 128, 3), np.uint8)
    for i, color in enumerate([(220, 30, 30), (30, 200, 40), (40, 40, 210), (200, 200, 60)]):
        frame[:, 32 * i : 32 * (i + 1)] = color
    info = VideoInfo(128, 96, 25, 5, colors=(matrix, 1, 6))
    with video_writer(tmp_path / "clip.mp4", info, "medium") as write:
        for _ in range(5):
            write(frame)
    copied(tmp_path / "clip.mp4", tmp_path / "copy.mp4")
    assert video_info(tmp_path / "copy.mp4").colors == (matrix, 1, 6)
    for path in (tmp_path / "clip.mp4", tmp_path / "copy.mp4"):
        back = next(read_frames(path))
        for i in range(4):
            inner = np.s_[8:-8, 32 * i + 8 : 32 * i + 24]
            np.testing.assert_allclose(back[inner].mean((0, 1)), frame[inner].mean((0, 1)), atol=6)


@pytest.mark.parametrize("matrix", [0, 8, 14])
def test_a_matrix_that_is_not_written_is_not_named(tmp_path, matrix):
    info = VideoInfo(128, 96, 25, 1, colors=(matrix, 1, 1))
    with video_writer(tmp_path / "clip.mp4", info) as write:
        write(np.zeros((96, 128, 3), np.uint8))
    assert video_info(tmp_path / "clip.mp4").colors == (2, 1, 1)


def test_other_matrix_means_other_colours(tmp_path):
    """The tag is honoured: the same bytes are other colours with another one."""
    red = [np.full((96, 128, 3), (220, 30, 30), np.uint8)]
    seen = []
    for matrix in (1, 5):
        path = encoded(tmp_path / f"{matrix}.mp4", red, colorspace=matrix)
        seen.append(next(read_frames(path)).mean((0, 1)))
    assert np.abs(seen[0] - seen[1]).max() > 5


def test_pixels_keep_their_shape(tmp_path):
    path = encoded(tmp_path / "clip.mp4", moving_frames(5), sample_aspect_ratio=Fraction(4, 3))
    copied(path, tmp_path / "copy.mp4")
    assert video_info(tmp_path / "copy.mp4").sample_aspect_ratio == Fraction(4, 3)


def with_rotation(path, quarter_turns):
    """An mp4 whose header says that it is to be shown turned, clockwise."""
    content = bytearray(path.read_bytes())
    place = content.index(b"tkhd") + 4 + 40
    turn = {1: (0, 1, -1, 0), 2: (-1, 0, 0, -1), 3: (0, -1, 1, 0)}[quarter_turns]
    matrix = (turn[0], turn[1], 0, turn[2], turn[3], 0, 0, 0)
    for i, value in enumerate(matrix):
        content[place + 4 * i : place + 4 * i + 4] = (value << 16).to_bytes(4, "big", signed=True)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_frames_are_upright(tmp_path, turns):
    frames = list(moving_frames(5))
    path = with_rotation(encoded(tmp_path / "clip.mp4", frames), turns)
    expected = np.rot90(frames[0], -turns)
    info = video_info(path)
    assert (info.height, info.width) == expected.shape[:2]
    copied(path, tmp_path / "copy.mp4")
    for video in (path, tmp_path / "copy.mp4"):
        back = next(read_frames(video))
        assert back.shape == expected.shape
        assert np.abs(back.astype(int) - expected).mean() < 12


def test_interlaced_frames_become_whole(tmp_path):
    reader = copied(CASES / "interlaced.mp4", tmp_path / "copy.mp4")
    assert reader.lost == []
    frames = list(read_frames(CASES / "interlaced.mp4"))
    assert len(frames) == 37 and min(frame.mean() for frame in frames) > 40

    def combs(frame):
        """How much neighbouring rows differ by more than those two apart."""
        gray = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY).astype(int)
        return (np.abs(gray[1:-1] - gray[2:]) > 20 + np.abs(gray[:-2] - gray[2:])).mean()

    with av.open(str(CASES / "interlaced.mp4")) as container:
        raw = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert np.mean([*map(combs, frames)]) < 0.5 * np.mean([*map(combs, raw)])


# ----------------------------------------------------------------- what is lost


@pytest.mark.parametrize(
    ("name", "lost", "last"), [("damaged.mp4", [(41, 41)], 150), ("damaged.avi", [(29, 41)], 75)]
)
def test_what_cannot_be_decoded_is_said_and_counted(name, lost, last):
    reader = VideoReader(CASES / name)
    numbers = [frame.number for frame in reader]
    assert reader.lost == lost
    gone = {n for first, end in lost for n in range(first, end + 1)}
    assert numbers == [n for n in range(1, last + 1) if n not in gone]
    assert f"{len(gone)} frame" in reader.losses() and str(lost[0][0]) in reader.losses()


def test_frames_in_a_damaged_avi_are_those_of_the_whole_one(tmp_path):
    """By their pictures: a bright patch wanders six pixels to the right a frame."""
    path = encoded(tmp_path / "clip.avi", moving_frames(36), "mjpeg")
    content = bytearray(path.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 4000] = bytes(4000)
    path.write_bytes(content)
    reader = VideoReader(path)
    found = list(reader)
    assert reader.lost and len(found) < 36

    def place(frame):
        bright = (frame.rgb[112:148].min(axis=(0, 2)) < 120) & (
            frame.rgb[112:148, :, 0].mean(0) > 200
        )
        return np.flatnonzero(bright).mean()

    for frame in (found[2], found[-1]):
        assert place(frame) == pytest.approx(69.5 + 6 * (frame.number - 1), abs=3)


def test_frames_that_are_lost_stop_whoever_counts_them():
    with pytest.raises(ValueError, match=r"damaged\.mp4: 1 frame cannot be decoded: 41"):
        list(read_frames(CASES / "damaged.mp4"))


def test_truncated_video_is_read_as_far_as_it_goes(tmp_path):
    path = write_video(tmp_path / "clip.mp4", moving_frames(100))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    reader = VideoReader(path)
    n_read = sum(1 for _ in reader)
    assert 20 < n_read < 80
    assert reader.lost[-1][1] == 100


def test_a_wrong_promise_changes_nothing(tmp_path):
    """Sound that is longer than the picture makes the header promise more frames."""
    path = encoded(tmp_path / "clip.mkv", moving_frames(10), sound="aac")
    assert video_info(path).n_frames > 15
    assert len(list(read_frames(path))) == 10


# -------------------------------------------------------------- what is refused


def test_bad_videos_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.mp4: no such video"):
        video_info(tmp_path / "gone.mp4")
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(ValueError, match=r"text\.mp4: not a readable video"):
        video_info(tmp_path / "text.mp4")
    assert not is_video(tmp_path / "text.mp4")
    whole = write_video(tmp_path / "clip.mp4", moving_frames(10)).read_bytes()
    (tmp_path / "empty.mp4").write_bytes(whole[: whole.index(b"mdat") + 4])
    with pytest.raises(ValueError, match=r"empty\.mp4: not (one frame|a readable)"):
        list(VideoReader(tmp_path / "empty.mp4"))


@pytest.mark.parametrize(
    "text",
    [
        "ffconcat version 1.0\nfile '{}'\n",
        "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\n{}\n#EXT-X-ENDLIST\n",
    ],
)
def test_references_to_other_files_are_refused(tmp_path, text):
    secret = write_video(tmp_path / "secret.mp4", moving_frames(5))
    for name in ("list.mp4", "list.ffconcat", "list.m3u8"):
        (tmp_path / name).write_text(text.format(secret))
        assert not is_video(tmp_path / name)
        with pytest.raises(ValueError, match="not a readable video"):
            video_info(tmp_path / name)


@pytest.mark.parametrize("name", ["12:30.mp4", "-clip.mp4", "concat:a.mp4", "a`b`.mp4", "%02d.mp4"])
def test_any_name_will_do(tmp_path, name):
    path = write_video(tmp_path / name, moving_frames(5))
    assert len(list(read_frames(path))) == 5 and is_video(path)


def test_bytes_that_are_no_text_are_a_name(tmp_path):
    folder = str(tmp_path).encode()
    path = write_video(tmp_path / "plain.mp4", moving_frames(5))
    odd = folder + b"/\xff\xfe.mp4"
    path.rename(odd.decode(errors="surrogateescape"))
    assert len(list(read_frames(odd.decode(errors="surrogateescape")))) == 5


@pytest.mark.parametrize("suffix", ["ts", "m2ts", "mkv", "mpg", "3gp", "gif"])
def test_containers_of_cameras_are_read(tmp_path, suffix):
    codec = {"mpg": "mpeg2video", "gif": "gif"}.get(suffix, "libx264")
    if suffix == "gif":
        with av.open(str(tmp_path / "clip.gif"), "w") as output:
            stream = output.add_stream("gif", rate=25)
            stream.width, stream.height, stream.pix_fmt = 320, 180, "rgb8"
            for frame in moving_frames(10):
                picture = av.VideoFrame.from_ndarray(frame, "rgb24").reformat(format="rgb8")
                output.mux(stream.encode(picture))
            output.mux(stream.encode(None))
    else:
        encoded(tmp_path / f"clip.{suffix}", moving_frames(10), codec)
    # What it is called does not matter.
    path = (tmp_path / f"clip.{suffix}").rename(tmp_path / "clip.bin")
    assert is_video(path)
    frames = list(read_frames(path))
    assert len(frames) == 10 and frames[0].shape == (180, 320, 3)


def test_failed_video_leaves_nothing(tmp_path):
    info = VideoInfo(320, 180, 25, 2)
    with pytest.raises(RuntimeError), video_writer(tmp_path / "a.mp4", info) as write:
        write(next(moving_frames(1)))
        raise RuntimeError
    with (
        pytest.raises(ValueError, match="does not fit the video"),
        video_writer(tmp_path / "b.mp4", info) as write,
    ):
        write(textured_image(0, 90, 160))
    with pytest.raises(ValueError, match="no frame"), video_writer(tmp_path / "d.mp4", info):
        pass
    with pytest.raises(ValueError, match="written as"), video_writer(tmp_path / "e.xyz", info):
        pass
    with (
        pytest.raises(OSError, match=r"/c\.mp4: cannot be encoded"),
        video_writer(tmp_path / "c.mp4", info, "no preset") as write,
    ):
        for frame in moving_frames(40):
            write(frame)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_said(tmp_path, monkeypatch):
    resource = pytest.importorskip("resource")
    signal = pytest.importorskip("signal")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(OSError, match=r"clip\.mp4: cannot be encoded: .*[Ll]arge"):
            write_video(tmp_path / "clip.mp4", [textured_image(i, 360, 640) for i in range(30)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_at_the_very_end_is_said(tmp_path):
    """Few frames fit into the encoder: it fails when it is closed."""
    info = VideoInfo(320, 180, 25, 5)
    with (
        open("/dev/full", "r+b", buffering=0) as file,
        pytest.raises(OSError, match="cannot be encoded: .*No space left"),
        encoding(file, tmp_path / "clip.mp4", info) as write,
    ):
        for frame in moving_frames(5):
            write(frame)


def test_what_is_live_can_be_read_while_it_is_written(tmp_path):
    path = tmp_path / "live.mp4"
    info = VideoInfo(320, 180, 25, 0)
    with (
        open(path, "w+b", buffering=0) as file,
        encoding(file, path, info, is_live=True) as write,
    ):
        for i, frame in enumerate(list(moving_frames(40)) * 3):
            write(frame, i)
        for _ in range(100):
            time.sleep(0.1)
            if path.stat().st_size > 10_000:
                break
        assert len(list(VideoReader(path))) > 20
    assert len(list(VideoReader(path))) == 120


def test_a_codec_that_nobody_knows_is_no_video(tmp_path):
    path = write_video(tmp_path / "clip.mp4", moving_frames(5))
    path.write_bytes(path.read_bytes().replace(b"avc1", b"xyz1"))
    assert not is_video(path)
    with pytest.raises(ValueError, match="no video in it that can be decoded"):
        video_info(path)


@given(times=st.lists(st.integers(-1000, 1000), min_size=1, max_size=20))
def test_times_only_rise(times):
    timeline = Timeline()
    found = [timeline.after(time) for time in times]
    assert all(b > a for a, b in pairwise(found)) and found[0] == times[0]
    rising = sorted(set(times))
    timeline = Timeline()
    assert [timeline.after(time) for time in rising] == rising


def test_joined_recordings_go_on(tmp_path):
    """Two transport streams, one behind the other: times and sound begin again."""
    once = encoded(tmp_path / "once.ts", moving_frames(25), sound="aac").read_bytes()
    (tmp_path / "twice.ts").write_bytes(once + once)
    copied(tmp_path / "twice.ts", tmp_path / "copy.mp4")
    times = seconds(tmp_path / "copy.mp4")
    assert len(times) == 50 and 1.8 < times[-1] < 2.3
    assert np.diff(times).min() > 0.03
    assert packets(tmp_path / "copy.mp4", "audio")[1][-1][0] > 1.5


def test_a_resolution_that_changes_ends_nothing(tmp_path):
    small = encoded(tmp_path / "small.ts", moving_frames(10)).read_bytes()
    large = encoded(tmp_path / "large.ts", moving_frames(10, 360, 640)).read_bytes()
    (tmp_path / "both.ts").write_bytes(small + large)
    shapes = {frame.shape for frame in read_frames(tmp_path / "both.ts")}
    assert shapes == {(180, 320, 3)}
    copied(tmp_path / "both.ts", tmp_path / "copy.mp4")


def test_times_of_an_avi_without_an_index(tmp_path):
    path = encoded(tmp_path / "clip.avi", moving_frames(30), "mjpeg")
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"idx1")])
    reader = VideoReader(path)
    assert [frame.time for frame in reader] == list(range(30)) and reader.lost == []


@pytest.mark.parametrize("rate", [6000, 192_000])
def test_sound_of_an_odd_rate_is_kept(tmp_path, rate):
    path = tmp_path / "clip.mov"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 320, 180, "yuv420p"
        tone = output.add_stream("pcm_s16le", rate=rate, layout="mono")
        for frame in moving_frames(25):
            output.mux(stream.encode(av.VideoFrame.from_ndarray(frame, "rgb24")))
        output.mux(stream.encode(None))
        samples = av.AudioFrame.from_ndarray(np.zeros((1, rate), np.int16), "s16", "mono")
        samples.rate, samples.pts = rate, 0
        output.mux(tone.encode(samples))
        output.mux(tone.encode(None))
    copied(path, tmp_path / "copy.mp4")
    assert packets(tmp_path / "copy.mp4", "audio")[0] == "aac"


def test_an_empty_file_is_no_video(tmp_path):
    (tmp_path / "empty.mp4").touch()
    assert not is_video(tmp_path / "empty.mp4")
    with pytest.raises(ValueError, match=r"empty\.mp4: not a readable video"):
        video_info(tmp_path / "empty.mp4")
