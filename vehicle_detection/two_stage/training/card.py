"""The model card of a detector: what it is, and what it learned from."""

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

**Configuration.** {configuration}.

**How to make it.**

```sh
{command}
```

**How good it is.** The picture beside the file shows what is confused in some frames that it
learned from. On cameras that it has not learned from, expect less.
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
