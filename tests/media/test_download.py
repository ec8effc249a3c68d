"""Data in one command, from a server on this machine that does what servers do."""

import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from conftest import moving_frames, textured_image, write_video
from vehicle_detection.media import download
from vehicle_detection.media.download import Origin, fetch, gather
from vehicle_detection.media.images import write_image


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """The files as they are published, but few and small."""
    folder = tmp_path / "published"
    monkeypatch.setattr(download, "PICTURES", ("test_images/test1.jpg", "camera_cal/c1.jpg"))
    monkeypatch.setattr(download, "ARCHIVES", {"vehicles.zip": 3, "non-vehicles.zip": 3})
    monkeypatch.setattr(download, "_RETRIES", 2)
    for name in download.PICTURES:
        write_image(folder / name, textured_image(0, 80, 96))
    for name in download.VIDEOS:
        write_video(folder / name, moving_frames(3))
    write_image(folder / "one.png", textured_image(0, 64, 64))
    content = (folder / "one.png").read_bytes()
    for name in ("vehicles", "non-vehicles"):
        with zipfile.ZipFile(folder / f"{name}.zip", "w") as archive:
            for i in range(3):
                archive.writestr(f"{name}/GTI_Far/{i}.png", content)
            # What macOS adds, and a name that leads out of the folder.
            archive.writestr(f"__MACOSX/{name}/GTI_Far/._0.png", b"macOS")
            archive.writestr(f"{name}/GTI_Far/._1.png", b"macOS")
            archive.writestr(f"{name}/.DS_Store", b"macOS")
            archive.writestr(f"{name}/../../evil.png", content)
    return folder


@pytest.fixture
def server(tree):
    """Serves the tree; `answers` holds, for a path, what to do instead, once each."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            server.asked.append(self.path)
            path = tree / self.path.lstrip("/")
            waiting = server.answers.get(self.path, [])
            answer = waiting.pop(0) if waiting else "whole"
            if not path.is_file() or isinstance(answer, int):
                self.send_error(answer if isinstance(answer, int) else 404)
                return
            content = path.read_bytes()
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            if answer == "lie":
                content = b"<html>please log in</html>".ljust(len(content))
            # What is cut ends before its length.
            self.wfile.write(content[: len(content) // 2] if answer == "cut" else content)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.answers, server.asked = {}, []
    server.url = f"http://127.0.0.1:{server.server_port}"
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def files(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


EXPECTED = sorted(
    ["test_images/test1.jpg", "camera_cal/c1.jpg", "test_video.mp4", "project_video.mp4"]
    + [f"{name}/GTI_Far/{i}.png" for name in ("vehicles", "non-vehicles") for i in range(3)]
)


def test_everything_comes_and_nothing_else(server, tmp_path):
    gather(Origin(mirror=server.url), tmp_path / "data")
    assert files(tmp_path / "data") == EXPECTED
    assert not list(tmp_path.rglob("evil.png"))
    n_asked = len(server.asked)
    gather(Origin(mirror=server.url), tmp_path / "data")
    assert len(server.asked) == n_asked


def test_archives_that_are_there_already(tree, tmp_path):
    gather(Origin(folder=tree), tmp_path / "data")
    assert files(tmp_path / "data") == EXPECTED
    (tree / "vehicles.zip").unlink()
    with pytest.raises(FileNotFoundError, match=r"vehicles\.zip"):
        gather(Origin(folder=tree), tmp_path / "other")


@pytest.mark.parametrize("answer", ["cut", 503])
def test_what_fails_once_is_tried_again(server, tmp_path, answer):
    server.answers = {"/vehicles.zip": [answer], "/test_images/test1.jpg": [answer]}
    gather(Origin(mirror=server.url), tmp_path / "data")
    assert files(tmp_path / "data") == EXPECTED


@pytest.mark.parametrize("answer", ["cut", 404, 503])
def test_what_fails_always_is_said_and_leaves_nothing(server, tmp_path, answer):
    server.answers = {"/vehicles.zip": [answer] * 9}
    with pytest.raises(OSError, match=r"vehicles\.zip: cannot be downloaded"):
        gather(Origin(mirror=server.url), tmp_path / "data")
    assert not (tmp_path / "data/vehicles.zip").exists()
    # The next run goes on with what is missing.
    server.answers, server.asked = {}, []
    gather(Origin(mirror=server.url), tmp_path / "data")
    assert server.asked[0] == "/vehicles.zip" and files(tmp_path / "data") == EXPECTED


@pytest.mark.parametrize("name", ["vehicles.zip", "test_images/test1.jpg", "test_video.mp4"])
def test_a_lie_is_noticed(server, tmp_path, name):
    server.answers = {f"/{name}": ["lie"]}
    with pytest.raises(ValueError, match=f"{name}: not what it should be"):
        gather(Origin(mirror=server.url), tmp_path / "data")
    gather(Origin(mirror=server.url), tmp_path / "data")
    assert files(tmp_path / "data") == EXPECTED


def test_a_damaged_archive_is_fetched_anew(tree, tmp_path):
    path = tree / "vehicles.zip"
    whole = path.read_bytes()
    # Within compressed data: what is found is no longer a stream.
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(3):
            archive.writestr(f"vehicles/a/{i}.png", bytes(range(256)) * 40)
    damaged = bytearray(path.read_bytes())
    damaged[60:90] = bytes([255]) * 30
    path.write_bytes(damaged)
    with pytest.raises(ValueError, match=r"vehicles\.zip: not what it should be"):
        gather(Origin(folder=tree), tmp_path / "data")
    assert not (tmp_path / "data/vehicles.zip").exists()
    path.write_bytes(whole)
    gather(Origin(folder=tree), tmp_path / "data")


def test_archives_of_ones_own_are_never_deleted(tree, tmp_path):
    with pytest.raises(ValueError, match="archives lie here already"):
        gather(Origin(folder=tree), tree)
    out = tmp_path / "data"
    out.mkdir()
    (out / "vehicles.zip").write_text("mine")
    with pytest.raises(ValueError, match=r"vehicles\.zip: not what it should be.*delete it"):
        gather(Origin(folder=tree), out)
    assert (out / "vehicles.zip").read_text() == "mine" and (tree / "vehicles.zip").exists()


def test_images_are_counted(tree, tmp_path, monkeypatch):
    monkeypatch.setattr(download, "ARCHIVES", {"vehicles.zip": 4, "non-vehicles.zip": 3})
    with pytest.raises(ValueError, match=r"vehicles\.zip: 3 images instead of 4"):
        gather(Origin(folder=tree), tmp_path / "data")
    assert not (tmp_path / "data/vehicles").exists()


def test_where_files_are_published():
    assert Origin().address("vehicles.zip").startswith("https://s3.amazonaws.com/udacity-sdc/")
    assert "CarND-Vehicle-Detection" in Origin().address("project_video.mp4")
    assert "CarND-Advanced-Lane-Lines" in Origin().address("camera_cal/calibration1.jpg")
    assert len(download.PICTURES) == 26 and sum(download.ARCHIVES.values()) == 17760


def test_what_is_there_is_not_fetched(server, tmp_path):
    (tmp_path / "test_video.mp4").write_text("mine")
    assert fetch(Origin(mirror=server.url), "test_video.mp4", tmp_path).read_text() == "mine"
    assert server.asked == []
