"""The model card of a detector: what it is, what it learned from, where it fails."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from vehicle_detection.two_stage.model import FORMAT_VERSION

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams

_CARD = """\
# Model card of the two-stage detector

`{name}`, format {version}, SHA-256 `{digest}`.

**What it does.** It finds cars, vans, pick-ups, lorries and buses in pictures of a car's front
camera, from about 25 pixels of height on, and follows them through a video.

**What it learned from.** Each camera counts alike.

| source | frames or images |
|---|---|
{sources}

[data.md](data.md) names origins and licences; most of the footage is for research use only.

**What it never learned from.** Frames 631-1260 of the project video, the test images of the
course, and `test_video.mp4`.

**Configuration.** {configuration}.

**How to make it.**

```sh
{command}
```

**How good it is.** [results.md](results.md) has figures by camera. On cameras that it has not
learned from, expect those of the leave-one-out table, not those of the project video.

**Where it fails.** Vehicles seen from the side and far away are missed most. Night, rain, side
streets, fish-eye pictures, and vehicles hidden by more than half were not learned. A still shows a
false box in every third to fifth picture: shop windows, people in dark clothes, signs near the
road.
"""


def model_card(path: Path, sources: dict, command: str, params: TrainingParams) -> str:
    """Text of the card, as Markdown.

    Parameters
    ----------
    path : Path
        Of the detector's file.
    sources : dict of str to int
        How many frames or images of what were learned from.
    command : str
        That trains it.
    params : TrainingParams

    Returns
    -------
    card : str
    """
    return _CARD.format(
        name=path.name,
        version=FORMAT_VERSION,
        digest=hashlib.sha256(path.read_bytes()).hexdigest(),
        sources="\n".join(f"| {name} | {count} |" for name, count in sources.items()),
        configuration=", ".join(f"{name} {value}" for name, value in asdict(params).items()),
        command=command,
    )
