"""Find the vehicles in images and videos, without a notebook.

python detect.py INPUT... --out DIR
"""

import argparse
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from files import (
    IMAGE_SUFFIXES,
    VIDEO_SUFFIXES,
    find_images,
    read_image,
    write_image,
    write_whole,
)
from pipeline_functions import SEARCH_PRESETS
from vehicle import FILTER_PRESETS, Vehicle
from video import read_frames, video_info, video_writer


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
        frame,id,left,top,width,height,score,-1,-1,-1 with id -1: no identity.

    References
    ----------
    .. [1] L. Leal-Taixe et al., "MOTChallenge 2015", arXiv:1504.01942.
    """
    return [
        f"{frame_number},-1,{left},{top},{right - left},{bottom - top},{score:.3f},-1,-1,-1"
        for (left, top, right, bottom), score in zip(
            detections.boxes, detections.scores, strict=True
        )
    ]


def write_rows(path, rows):
    """Write rows of text to a file, whole or not at all."""
    write_whole(path, "".join(row + "\n" for row in rows))


def annotate_image(source, folder, vehicle):
    """Detect in one image; write the annotated image and its boxes into a folder.

    Returns
    -------
    rows : list of str
        See `mot_rows`.
    """
    img = read_image(source)
    vehicle.reset()
    detections = vehicle.detect(img)
    write_image(folder / source.name, vehicle.draw(img, detections))
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
            detections = vehicle.detect(frame)
            rows += mot_rows(frame_number, detections)
            for write, draw in outputs:
                write(draw(frame, detections))
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
        nor video by its suffix; or two inputs would write the same output.
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
    stems = set()
    for path in images + videos:
        if path.stem in stems:
            raise ValueError(f"{path}: another input would write {path.stem}.txt too")
        stems.add(path.stem)
    return images, videos


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
        "--param", type=Path, default=Path("param/svc_pickle.p"), help="from train.py"
    )
    parser.add_argument(
        "--calib", type=Path, help="from calibrate.py; pictures are then drawn undistorted"
    )
    parser.add_argument(
        "--filter", choices=("G", "B"), default="G", help="temporal filter of write-up G or B"
    )
    parser.add_argument(
        "--search", choices=SEARCH_PRESETS, default="G", help="scales and bands of write-up G or B"
    )
    parser.add_argument(
        "--horizon",
        type=float,
        metavar="SHARE",
        help="where the road vanishes, as a share of the picture's height (0.57, say): visit "
        "only windows that could frame a vehicle on the road",
    )
    parser.add_argument(
        "--scan-every",
        type=int,
        default=1,
        metavar="N",
        help="visit all windows in every Nth frame, in others only those near known vehicles",
    )
    parser.add_argument(
        "--split-screen", action="store_true", help="also a video of every step of the detector"
    )
    parser.add_argument("--preset", default="ultrafast", help="of the video encoder, libx264")
    return parser.parse_args(arguments)


def chosen_search(arguments):
    """The preset search, with what the command line changes of it."""
    search = SEARCH_PRESETS[arguments.search]
    horizon = arguments.horizon
    if horizon is not None:
        horizon *= search.reference_size[1]
    return replace(search, horizon=horizon, scan_every=arguments.scan_every)


def main():
    """Run the command line."""
    arguments = parse_arguments()
    try:
        images, videos = gather_inputs(arguments.inputs)
        paths = arguments.calib, arguments.param
        if images:
            still = Vehicle(*paths, chosen_search(arguments), FILTER_PRESETS["still"])
            for path in tqdm(images, "images", unit="image"):
                annotate_image(path, arguments.out, still)
        for path in videos:
            heat_filter = FILTER_PRESETS[arguments.filter]
            vehicle = Vehicle(*paths, chosen_search(arguments), heat_filter)
            annotate_video(path, arguments.out, vehicle, arguments.split_screen, arguments.preset)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")
    print(f"wrote {len(images)} images and {len(videos)} videos to {arguments.out}")


if __name__ == "__main__":
    main()
