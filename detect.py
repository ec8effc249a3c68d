"""Find the vehicles in images and videos, without a notebook.

python detect.py INPUT... --out DIR
"""

import argparse
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from pipeline_functions import SEARCH_PRESETS
from vehicle import FILTER_PRESETS, HeatVehicle
from vehicle_detection.media.images import (
    IMAGE_SUFFIXES,
    VIDEO_SUFFIXES,
    find_images,
    read_image,
    write_image,
    write_whole,
)
from vehicle_detection.media.videos import ENCODER_PRESETS, read_frames, video_info, video_writer
from vehicle_detection.two_stage.vehicle import STILL_SCAN, STILL_TRACKS, Vehicle


def mot_rows(frame_number, detections):
    """Detections of one frame as rows of a MOTChallenge file.

    Parameters
    ----------
    frame_number : int
        From 1.
    detections : Detections

    Returns
    -------
    rows : list of str
        frame,id,left,top,width,height,score,-1,-1,-1, the id constant per vehicle.

    References
    ----------
    .. [1] L. Leal-Taixe et al., "MOTChallenge 2015", arXiv:1504.01942.
    """
    return [
        f"{frame_number},{identity},{left},{top},{right - left},{bottom - top},{score:.3f},-1,-1,-1"
        for identity, (left, top, right, bottom), score in zip(
            detections.ids, detections.boxes, detections.scores, strict=True
        )
    ]


def write_rows(path, rows):
    """Write rows of text to a file, whole or not at all."""
    write_whole(path, "".join(row + "\n" for row in rows))


@contextmanager
def naming(source):
    """Put the file's name before what is wrong with a frame of it."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error


def annotate_image(source, folder, vehicle):
    """Detect in one image; write the annotated image and its boxes into a folder.

    Returns
    -------
    rows : list of str
        See `mot_rows`.
    """
    img = read_image(source)
    vehicle.reset()
    with naming(source):
        detections = vehicle.detect(img)
        picture = vehicle.draw(img, detections)
    write_image(folder / source.name, picture)
    rows = mot_rows(1, detections)
    write_rows(folder / f"{source.stem}.txt", rows)
    return rows


def annotate_video(source, folder, vehicle, split_screen=False, preset="ultrafast"):
    """Detect in a video; write the annotated video and its boxes into a folder.

    Parameters
    ----------
    source, folder : Path
    vehicle : Vehicle
        Is reset first.
    split_screen : bool
        Also write STEM_split.mp4, see `Vehicle.draw_split_screen`.
    preset : str
        Of the encoder, see `video.video_writer`.

    Returns
    -------
    rows : list of str
        See `mot_rows`.
    """
    info = video_info(source)
    vehicle.reset()
    rows = []
    with ExitStack() as stack:
        outputs = [
            (stack.enter_context(video_writer(folder / f"{source.stem}.mp4", info, preset)),
             vehicle.draw)
        ]  # fmt: skip
        if split_screen:
            path = folder / f"{source.stem}_split.mp4"
            write = stack.enter_context(video_writer(path, info, preset))
            outputs.append((write, vehicle.draw_split_screen))
        frames = tqdm(read_frames(source), source.name, info.n_frames, unit="frame")
        for frame_number, frame in enumerate(frames, start=1):
            with naming(source):
                detections = vehicle.detect(frame)
                pictures = [draw(frame, detections) for _, draw in outputs]
            for (write, _), picture in zip(outputs, pictures, strict=True):
                write(picture)
            rows += mot_rows(frame_number, detections)
    write_rows(folder / f"{source.stem}.txt", rows)
    return rows


def gather_inputs(paths):
    """Split command line paths into images and videos; folders are opened.

    Returns
    -------
    images, videos : list of Path

    Raises
    ------
    FileNotFoundError, ValueError
        A path is missing, is a folder without images, or is neither image
        nor video by its suffix.
    """
    images, videos = [], []
    for path in paths:
        if path.is_dir():
            images += find_images(path)
        elif path.suffix.lower() in IMAGE_SUFFIXES:
            images.append(path)
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            videos.append(path)
        elif path.exists():
            raise ValueError(f"{path}: neither an image nor a video that is known here")
        else:
            raise FileNotFoundError(f"{path}: no such file or folder")
    return images, videos


def require_free_names(images, videos, folder):
    """Refuse inputs whose outputs would overwrite an input or each other.

    Raises
    ------
    ValueError
        Naming the input.
    """
    taken = {path.resolve() for path in images + videos}
    for path in images + videos:
        names = [path.name, f"{path.stem}.txt"]
        if path in videos:
            names = [f"{path.stem}.mp4", f"{path.stem}_split.mp4", f"{path.stem}.txt"]
        for name in names:
            output = (folder / name).resolve()
            if output in taken:
                raise ValueError(f"{path}: its output {folder / name} is taken: use another --out")
            taken.add(output)


def share(text):
    """A number between 0 and 1 from the command line."""
    value = float(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError("a share lies between 0 and 1")
    return value


def add_search_options(parser):
    """Options of the way of the write-ups."""
    group = parser.add_argument_group("the write-ups' way", "only with --filter G or B")
    group.add_argument(
        "--search",
        choices=SEARCH_PRESETS,
        default=argparse.SUPPRESS,
        help="scales and bands of write-up G (default) or B",
    )
    group.add_argument(
        "--horizon",
        type=share,
        default=argparse.SUPPRESS,
        metavar="SHARE",
        help="where the road vanishes, as a share of the picture's height (0.57, say): visit "
        "only windows that could frame a vehicle on the road",
    )
    group.add_argument(
        "--scan-every",
        type=int,
        default=argparse.SUPPRESS,
        metavar="N",
        help="visit all windows in every Nth frame, in others only those near known vehicles",
    )


def parse_arguments(arguments=None):
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        description="Box the vehicles in images and videos. Writes an annotated copy of "
        "each input and a text file of boxes, MOTChallenge rows in pixels of the frame as read.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("inputs", nargs="+", type=Path, help="images, folders of them, videos")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument(
        "--filter",
        choices=("tracks", "G", "B"),
        default="tracks",
        help="tracks: the two-stage detector; G, B: search and temporal filter of a write-up",
    )
    parser.add_argument(
        "--param",
        type=Path,
        default=argparse.SUPPRESS,
        help="from train_detector.py (default: param/detector.npz) or, with --filter G or B, "
        "from train.py (default: param/svc_pickle.p)",
    )
    parser.add_argument(
        "--calib", type=Path, help="from calibrate.py; pictures are then drawn undistorted"
    )
    add_search_options(parser)
    parser.add_argument(
        "--split-screen", action="store_true", help="of videos, also one of every step"
    )
    parser.add_argument(
        "--preset",
        choices=ENCODER_PRESETS,
        default="ultrafast",
        help="of the video encoder: a larger file or a longer wait",
    )
    return parser.parse_args(arguments)


def chosen_search(arguments):
    """The preset search, with what the command line changes of it."""
    search = SEARCH_PRESETS[getattr(arguments, "search", "G")]
    if "horizon" in arguments:
        search = replace(search, horizon=arguments.horizon * search.reference_size[1])
    if "scan_every" in arguments:
        search = replace(search, scan_every=arguments.scan_every)
    return search


def open_vehicle(arguments, is_still):
    """The detector that the command line asks for.

    Parameters
    ----------
    arguments : argparse.Namespace
        See `parse_arguments`.
    is_still : bool
        For pictures on their own instead of a video.

    Returns
    -------
    vehicle : Vehicle

    Raises
    ------
    FileNotFoundError, ValueError
        A parameter file is missing or of another kind; an option does not go
        with the filter.
    """
    if arguments.filter == "tracks":
        for name in ("search", "horizon", "scan_every"):
            if name in arguments:
                raise ValueError(f"--{name.replace('_', '-')} goes with --filter G or B only")
        paths = arguments.calib, getattr(arguments, "param", Path("param/detector.npz"))
        return Vehicle(*paths, STILL_SCAN, STILL_TRACKS) if is_still else Vehicle(*paths)
    paths = arguments.calib, getattr(arguments, "param", Path("param/svc_pickle.p"))
    heat_filter = FILTER_PRESETS["still" if is_still else arguments.filter]
    return HeatVehicle(*paths, chosen_search(arguments), heat_filter)


def main():
    """Run the command line."""
    arguments = parse_arguments()
    try:
        images, videos = gather_inputs(arguments.inputs)
        require_free_names(images, videos, arguments.out)
        if images:
            still = open_vehicle(arguments, is_still=True)
            for path in tqdm(images, "images", unit="image"):
                annotate_image(path, arguments.out, still)
        for path in videos:
            vehicle = open_vehicle(arguments, is_still=False)
            annotate_video(path, arguments.out, vehicle, arguments.split_screen, arguments.preset)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")
    print(f"wrote {len(images)} images and {len(videos)} videos to {arguments.out}")


if __name__ == "__main__":
    main()
