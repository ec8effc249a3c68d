"""A page that shows a video with its panels, its vehicles over time, and what deserves a look.

boxes, times, truth -> data of the report -> one HTML page, beside its video or with it inside
"""

from __future__ import annotations

import base64
import json
import os
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from vehicle_detection.evaluation.metrics import errors_by_frame, evaluate
from vehicle_detection.media.drawing import identity_color
from vehicle_detection.parameters import DEFAULT_REPORT, ReportParams

if TYPE_CHECKING:
    from vehicle_detection.media.annotate import Found
    from vehicle_detection.media.mot import Rows

_TEMPLATE = Path(__file__).with_name("page.html")


def report_data(
    title: str,
    found: Found,
    panels: Sequence,
    parameters: str,
    truth: Rows | None = None,
    params: ReportParams = DEFAULT_REPORT,
) -> dict:
    """All that the page shows, as plain values.

    Parameters
    ----------
    title : str
    found : Found
    panels : sequence of str
        What the four quarters of the video show.
    parameters : str
    truth : Rows, optional
    params : ReportParams

    Returns
    -------
    data : dict
    """
    rows, numbers = found.rows, [int(number) for number in found.numbers]
    vehicles = [_vehicle(identity, rows) for identity in np.unique(rows.ids).tolist()]
    data: dict = {
        "title": title,
        "numbers": numbers,
        "times": [round(float(time), 4) for time in found.times],
        "step": float(np.median(np.diff(found.times))) if len(numbers) > 1 else 0.04,
        "panels": list(panels),
        "vehicles": vehicles,
        "top": max([1.0, *(score for v in vehicles for _, score in v["scores"])]),
        "parameters": parameters,
        "errors": None,
        "figures": None,
    }
    notable = _notable(rows, vehicles, params)
    if found.losses:
        notable.append((numbers[0], found.losses))
    if truth is not None:
        frames = range(1, numbers[-1] + 1)
        misses, alarms = errors_by_frame(truth, rows, frames)
        wrong = [i for i in range(len(frames)) if misses[i] or alarms[i]]
        data["errors"] = [[frames[i], int(misses[i]), int(alarms[i])] for i in wrong]
        data["figures"] = _plain(evaluate(truth, rows, frames))
        # Where errors begin: those in a row have one cause.
        before = set(wrong)
        starts = [i for i in wrong if i - 1 not in before]
        notable += [(frames[i], f"{misses[i]} missed, {alarms[i]} false") for i in starts]
    # Evenly spread, so that no part of the video is left out.
    step = -(-len(notable) // params.most_notable) or 1
    data["notable"] = sorted(notable)[::step]
    data["left_out"] = len(notable) - len(data["notable"])
    return data


def _vehicle(identity, rows):
    """A vehicle's rows as plain values."""
    own = rows.only(rows.ids == identity)
    heights = own.boxes[:, 3] - own.boxes[:, 1]
    ends = np.flatnonzero(np.diff(own.frames) > 1)
    firsts = own.frames[np.concatenate([[0], ends + 1]).astype(int)].tolist()
    lasts = own.frames[np.concatenate([ends, [-1]]).astype(int)].tolist()
    red, green, blue = (round(0.75 * value) for value in identity_color(identity))
    return {
        "id": identity,
        "color": f"rgb({red},{green},{blue})",
        "first": firsts[0],
        "last": lasts[-1],
        "frames": len(own.frames),
        "score": f"{own.scores.mean():.2f}",
        "heights": f"{heights.min():.0f} to {heights.max():.0f}",
        "spans": [list(span) for span in zip(firsts, lasts, strict=True)],
        "scores": [
            [int(n), round(float(s), 3)] for n, s in zip(own.frames, own.scores, strict=True)
        ],
    }


def _notable(rows, vehicles, params):
    """Frames where a vehicle comes, goes, is missing or changes its size at once."""
    notable = []
    for vehicle in vehicles:
        name = f"no. {vehicle['id']}"
        notable.append((vehicle["first"], f"{name} is seen first"))
        notable.append((vehicle["last"], f"{name} is seen last"))
        for (_, end), (start, _) in zip(vehicle["spans"], vehicle["spans"][1:], strict=False):
            notable.append((end + 1, f"{name} is missing for {start - end - 1} frames"))
        own = rows.only(rows.ids == vehicle["id"])
        heights = np.log(own.boxes[:, 3] - own.boxes[:, 1])
        sudden = np.flatnonzero(np.abs(np.diff(heights)) > np.log(params.sudden_growth)) + 1
        notable += [(int(own.frames[i]), f"{name} changes its size at once") for i in sudden]
    return notable


def _plain(figures):
    """Figures as text by name."""
    plain = {}
    for name, value in figures.items():
        if not isinstance(value, dict):
            is_float = isinstance(value, float)
            plain[name] = "-" if value is None else f"{value:.3f}" if is_float else str(value)
    return plain


def page(data: dict, video: str | Path, embed: bool = False) -> str:
    """The page as HTML.

    Parameters
    ----------
    data : dict
        See `report_data`.
    video : path
        Of the video with the panels; relative to the page, unless it is put inside.
    embed : bool
        Put the video into the page.

    Returns
    -------
    html : str
    """
    source: Any = str(video)
    if embed:
        content = base64.b64encode(Path(video).read_bytes()).decode()
        source = f"data:video/mp4;base64,{content}"
    # Nothing in a name may end the script.
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
    parts = {"VIDEO_SOURCE": _attribute(source), "REPORT_DATA": text}
    html = _TEMPLATE.read_text(encoding="utf-8")
    # All at once: a name may be called like a part.
    return re.sub("|".join(parts), lambda match: parts[match[0]], html)


def _attribute(text):
    """Text as the value of an attribute; what is no address is escaped as one."""
    return text if text.startswith("data:") else escape(quote(os.fsencode(text)))
