"""Render everything the pipeline needs, for a machine that has no footage.

    python -m rendered_road.sample output/sample

writes scenes and training images of both classes cut from them, six test images, a driving video,
chessboard photos, and the true boxes. The same seed gives the same pictures.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from rendered_road.render import (
    BODIES,
    PAINTS,
    Actor,
    Camera,
    make_world,
    perspective_through_lens,
    render,
)
from vehicle_detection import command_line
from vehicle_detection.compiled.processes import in_parallel
from vehicle_detection.media.encoder import video_writer
from vehicle_detection.media.files import write_whole
from vehicle_detection.media.images import write_image
from vehicle_detection.media.videos import VideoInfo

FPS = 25
N_SCENES = 160
MOTORWAY_KINDS = ("saloon", "estate", "suv", "van", "truck")
# Of the kinds of `BODIES` in a town.
KIND_SHARES = (0.24, 0.22, 0.2, 0.12, 0.1, 0.06, 0.06)
_CLASS_CAR = 3


# -------------------------------------------------------------------- scenes


def random_scene(seed):
    """A world of its own with traffic around the camera.

    Returns
    -------
    world : World
    """
    rng = np.random.default_rng([seed, 10])
    empty = make_world(seed)
    actors = []
    for lane in range(empty.n_lanes):
        distance = rng.uniform(5, 22)
        while distance < 95:
            kind = str(rng.choice(MOTORWAY_KINDS, p=(0.34, 0.24, 0.22, 0.12, 0.08)))
            actors.append(_standing(len(actors) + 1, kind, distance, lane, rng))
            distance += BODIES[kind].length + rng.uniform(7, 45)
    beside = _vehicles_beside(empty, actors, np.random.default_rng([seed, 14]))
    return make_world(seed, actors + beside)


# Cameras of the training scenes: how wide they see, how high they hang, how they are pitched.
CAMERAS = (
    Camera(),
    Camera(focal=900.0, center=(640.0, 360.0), dist=(-0.1, 0.0, 0.0, 0.0, 0.0),
           horizon_below=-40.0),
    Camera(focal=760.0, center=(640.0, 360.0), dist=(-0.2, 0.03, 0.0, 0.0, 0.0), mount_height=1.2,
           horizon_below=10.0),
    Camera(focal=1500.0, center=(640.0, 360.0), dist=(0.0, 0.0, 0.0, 0.0, 0.0), mount_height=1.65,
           horizon_below=0.0),
    Camera(focal=1000.0, center=(640.0, 360.0), dist=(-0.05, 0.0, 0.0, 0.0, 0.0),
           mount_height=2.3, horizon_below=-90.0),
)  # fmt: skip


def town_scene(seed):
    """A street with vehicles at all angles: parked in rows, crossing, turning, oncoming.

    Returns
    -------
    world : World
    """
    rng = np.random.default_rng([seed, 15])
    empty = replace(make_world(seed), is_town=True, camera=CAMERAS[rng.integers(len(CAMERAS))])
    actors = []

    def add(distance, lane, yaw):
        """One more vehicle of any kind."""
        kind = str(rng.choice(list(BODIES), p=KIND_SHARES))
        actor = _standing(len(actors) + 1, kind, distance, lane, rng)
        actors.append(replace(actor, yaw=yaw + rng.normal(0, 0.04)))

    for lane, yaw in ((-0.75, np.pi * (rng.random() < 0.4)), (empty.n_lanes - 0.25, 0.0)):
        for distance in np.cumsum(rng.uniform(5.6, 9, 8)) + rng.uniform(-6, 6):
            if rng.random() < 0.6:
                add(distance + 5.5 * (yaw != 0), lane, yaw)
    for lane in range(empty.n_lanes):
        distance = rng.uniform(4, 25)
        while distance < 70:
            yaw = rng.choice([0.0, np.pi, rng.uniform(-np.pi, np.pi)], p=(0.5, 0.25, 0.25))
            add(distance + 5 * (np.cos(yaw) < 0), lane, yaw)
            distance += rng.uniform(9, 40)
    if rng.random() < 0.6:
        distance = rng.uniform(9, 35)
        for lane in np.cumsum(rng.uniform(1.6, 3, 3)) - 3:
            add(distance, lane, rng.choice([-1, 1]) * np.pi / 2)
    return replace(empty, actors=tuple(actors))


def _vehicles_beside(world, actors, rng):
    """In every other lane, now and then, one so near that the border cuts it: it comes in."""
    beside = []
    for lane in set(range(world.n_lanes)) - {world.own_lane}:
        kind = str(rng.choice(MOTORWAY_KINDS))
        distance = rng.uniform(1.5 - BODIES[kind].length, 5)
        ahead = min((a.distance for a in actors if round(a.lane) == lane), default=np.inf)
        if rng.random() < 0.5 and distance + BODIES[kind].length + 1.5 < ahead:
            identity = len(actors) + len(beside) + 1
            beside.append(_standing(identity, kind, distance, lane, rng))
    return beside


def _standing(identity, kind, distance, lane, rng):
    """A vehicle near the middle of a lane, of any paint, size and style."""
    return Actor(
        identity=identity,
        kind=kind,
        paint=PAINTS[rng.integers(len(PAINTS))],
        distance=float(distance),
        speed=0.0,
        lane=lane + float(rng.normal(0, 0.06)),
        size=float(rng.uniform(0.94, 1.07)),
        style=int(rng.integers(1_000_000)),
    )


def driving_world(seed):
    """The world of the video: overtaking, falling back, changing lanes, oncoming.

    Returns
    -------
    world : World
    """
    rng = np.random.default_rng([seed, 11])
    # The first seed from here on whose road has a lane on each side.
    world = next(
        w for w in map(make_world, range(seed + 50, seed + 150))
        if w.n_lanes >= 3 and 0 < w.own_lane < w.n_lanes - 1
    )  # fmt: skip
    own = world.own_lane
    ways = (
        ("saloon", -7, 3.2, own + 1, 0, 0), ("suv", 18, 0.9, own - 1, 1, 7),
        ("estate", 30, 1.4, own + 1, 0, 0), ("truck", 95, -3.4, own + 1, 0, 0),
        ("van", 62, -1.7, own - 1, 0, 0), ("saloon", 46, 0.4, own, 0, 0),
        ("estate", -38, 4.1, own - 1, 0, 0),
    )  # fmt: skip
    actors = [
        Actor(i, kind, PAINTS[rng.integers(len(PAINTS))], distance, speed, lane, change, when,
              size=float(rng.uniform(0.96, 1.05)), style=int(rng.integers(1_000_000)))
        for i, (kind, distance, speed, lane, change, when) in enumerate(ways, start=1)
    ]  # fmt: skip
    kinds = rng.choice(["saloon", "estate", "suv", "van"], size=12)
    actors += [
        Actor(100 + i, str(kind), PAINTS[rng.integers(len(PAINTS))], 90.0 + 85 * i, -56.0,
              -2.2 - i % 2, oncoming=True, style=i)
        for i, kind in enumerate(kinds)
    ]  # fmt: skip
    return make_world(world.seed, actors)


SCENES = {"motorway": random_scene, "town": town_scene}


def truth_rows(frame_number, truth):
    """True boxes of one frame as rows of a MOTChallenge file.

    Returns
    -------
    rows : list of str
        frame,id,left,top,width,height,conf,class,visibility; conf 0 marks a
        region in which detections are neither right nor wrong.
    """
    rows = []
    for box in truth:
        left, top, right, bottom = box.box
        rows.append(
            f"{frame_number},{box.identity},{left:.1f},{top:.1f},{right - left:.1f},"
            f"{bottom - top:.1f},{int(box.required)},{_CLASS_CAR},{box.visible:.2f}\n"
        )
    return rows


# ------------------------------------------------------------ training images


def cut(frame, box, size=64):
    """A box of a frame, resized to a square; None if it leaves the frame.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows, columns, 3)
    box : (left, top, right, bottom)
    size : int
    """
    left, top, right, bottom = (round(edge) for edge in box)
    rows, columns = frame.shape[:2]
    if left < 0 or top < 0 or right > columns or bottom > rows or right - left < 8:
        return None
    return cv2.resize(frame[top:bottom, left:right], (size, size), interpolation=cv2.INTER_AREA)


def vehicle_cuts(frame, truth, rng):
    """Images of the vehicles of a frame, framed as the public training sets frame them.

    Half are tight and squashed to a square as KITTI's are, half squares with
    a margin as GTI's are.
    """
    images = []
    for box in truth:
        left, top, right, bottom = box.box
        width, height = right - left, bottom - top
        if not box.required or box.visible < 0.75 or height < 26:
            continue
        x, y = (left + right) / 2, (top + bottom) / 2
        square = max(width, height)
        for side_x, side_y in ((width, height), (square, square)):
            margin = rng.uniform(1.0, 1.12) if side_x != side_y else rng.uniform(1.02, 1.25)
            dx, dy = rng.uniform(-0.05, 0.05, size=2) * (side_x, side_y)
            half_x, half_y = margin * side_x / 2, margin * side_y / 2
            image = cut(frame, (x + dx - half_x, y + dy - half_y, x + dx + half_x, y + dy + half_y))
            if image is not None:
                images.append(image)
    return images


def other_cuts(frame, truth, rng, count):
    """Squares of a frame that hold no vehicle, most of them at the height of the road."""
    images = []
    # In dense traffic there may be no place for as many.
    for _ in range(50 * count):
        if len(images) == count:
            break
        side = rng.uniform(44, 240)
        x = rng.uniform(0, frame.shape[1] - side)
        y = rng.uniform(0.45, 0.95) * frame.shape[0] - side / 2
        box = np.array([x, y, x + side, y + side])
        if all(_covered(box, other.box) < 0.08 for other in truth):
            image = cut(frame, box)
            if image is not None:
                images.append(image)
    return images


def _covered(box, other):
    """Share of a box that another covers, or the other way round if that is more."""
    width = min(box[2], other[2]) - max(box[0], other[0])
    height = min(box[3], other[3]) - max(box[1], other[1])
    areas = [(b[2] - b[0]) * (b[3] - b[1]) for b in (box, other)]
    return max(0, width) * max(0, height) / min(areas)


def cut_scene(seed, scene="motorway"):
    """A scene of `SCENES` with its truth, and training images of both classes from it."""
    rng = np.random.default_rng([seed, 12])
    frame, truth = render(SCENES[scene](seed), 0.0)
    vehicles = vehicle_cuts(frame, truth, rng)
    return frame, truth, (vehicles, other_cuts(frame, truth, rng, max(6, len(vehicles))))


def remove_numbered(folder):
    """Delete the images that an earlier run wrote here: more of them would lie beside the new."""
    for path in folder.glob("[0-9]*.*"):
        if path.stem.isdecimal() and path.suffix in (".jpg", ".png"):
            path.unlink()


def write_training_images(folder, seed=0, scenes=N_SCENES, jobs=-1, scene="motorway"):
    """Write vehicles/, non-vehicles/ and the scenes they are from, and say how many.

    Parameters
    ----------
    folder : Path
    seed : int
    scenes : int
    jobs : int
        Processes; -1 for one a core.
    scene : str
        Of `SCENES`.
    """
    counts, rows = {"vehicles": 0, "non-vehicles": 0}, []
    for name in ("scenes", *counts):
        remove_numbered(folder / name)
    seeds = list(range(seed + 1000, seed + 1000 + scenes))
    found = in_parallel(partial(cut_scene, scene=scene), seeds, jobs, scene)
    for number, (frame, truth, images) in enumerate(found, start=1):
        write_image(folder / "scenes" / f"{number:05d}.jpg", frame)
        rows += truth_rows(number, truth)
        for name, cuts in zip(counts, images, strict=True):
            for image in cuts:
                write_image(folder / name / f"{counts[name]:05d}.png", image)
                counts[name] += 1
    write_whole(folder / "scenes.gt.txt", "".join(rows))
    print(", ".join(f"{count} {name}" for name, count in counts.items()))


# ------------------------------------------------------- test images and video


def write_test_images(folder, seed, jobs):
    """Write test_images/ and their true boxes."""
    rows = []
    folder = folder / "test_images"
    seeds = range(seed + 100, seed + 106)
    scenes = [random_scene(seed) for seed in seeds]
    frames = in_parallel(partial(render, time=0.0), scenes, jobs, "test images")
    for number, (frame, truth) in enumerate(frames, start=1):
        write_image(folder / f"test{number}.jpg", frame)
        rows += truth_rows(number, truth)
    write_whole(folder / "test_images.gt.txt", "".join(rows))


def write_video(folder, seed, jobs, seconds):
    """Write videos/drive.mp4 and its true boxes."""
    world = driving_world(seed)
    times = np.arange(round(seconds * FPS)) / FPS
    info = VideoInfo(world.camera.width, world.camera.height, FPS, len(times))
    folder = folder / "videos"
    rows = []
    with video_writer(folder / "drive.mp4", info, preset="medium") as write:
        frames = in_parallel(partial(render, world), times, jobs, "video")
        for number, (frame, truth) in enumerate(frames, start=1):
            write(frame)
            rows += truth_rows(number, truth)
    write_whole(folder / "drive.gt.txt", "".join(rows))


# ---------------------------------------------------------------- chessboards


def chessboard_photo(seed, columns=9, rows=6):
    """A chessboard with this many inner corners, held in front of the camera.

    Returns
    -------
    photo : ndarray of uint8, shape (height, width, 3)
    """
    rng = np.random.default_rng([seed, 13])
    square, border = 80, 60
    y, x = np.mgrid[: (rows + 1) * square, : (columns + 1) * square] // square
    board = np.where((x + y) % 2, 20, 235).astype(np.uint8)
    board = np.pad(board, border, constant_values=235)
    height, width = board.shape
    turn, _ = cv2.Rodrigues(rng.uniform(-0.45, 0.45, size=3))
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    flat = np.column_stack([corners - (width / 2, height / 2), np.zeros(4)]) / square
    # Far enough away to be whole, near enough to fill much of the picture.
    points = flat @ turn.T + (rng.uniform(-2.5, 2.5), rng.uniform(-1.2, 1.2), rng.uniform(12, 17))
    camera = Camera()
    pixels = points[:, :2] / points[:, 2:] * camera.focal + camera.center
    photo = perspective_through_lens(camera, board, corners, pixels, background=105)
    photo = cv2.GaussianBlur(photo, (0, 0), 0.8) + rng.normal(0, 2, photo.shape)
    return np.repeat(np.clip(photo, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def write_chessboards(folder, seed, jobs):
    """Write camera_cal/, photos of a chessboard through the same lens."""
    photos = in_parallel(chessboard_photo, range(seed, seed + 14), jobs, "chessboards")
    for number, photo in enumerate(photos, start=1):
        write_image(folder / "camera_cal" / f"calibration{number}.jpg", photo)


PARTS = {
    "training": lambda a: write_training_images(a.out, a.seed, a.scenes, a.jobs, a.scene),
    "images": lambda a: write_test_images(a.out, a.seed, a.jobs),
    "video": lambda a: write_video(a.out, a.seed, a.jobs, a.seconds),
    "chessboards": lambda a: write_chessboards(a.out, a.seed, a.jobs),
}


def parse_arguments(arguments=None):
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        prog="python -m rendered_road.sample",
        description="Render training images, test images, a video and chessboard photos.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        epilog="example: %(prog)s output/sample --only video --seconds 10",
    )
    parser.add_argument("out", type=Path, help="folder to write to")
    parser.add_argument("--seed", type=int, default=0, help="of all that is random")
    parser.add_argument(
        "--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to render"
    )
    parser.add_argument(
        "--scenes", type=int, default=N_SCENES, help="scenes to write, and to cut images from"
    )
    parser.add_argument("--scene", choices=SCENES, default="motorway", help="of training images")
    parser.add_argument("--seconds", type=float, default=20, help="length of the video")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: one a core")
    return parser.parse_args(arguments)


def main():
    """Run the command line."""
    arguments = parse_arguments()
    for part in arguments.only:
        PARTS[part](arguments)
    print(f"wrote {arguments.out}")


if __name__ == "__main__":
    command_line.run(main)
