"""Executed notebooks as Markdown with small pictures, to be read without running anything.

python -m experiments.executed output/image_pipeline.ipynb docs/image_pipeline.md
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
from pathlib import Path

import cv2
import nbformat
import numpy as np
from nbconvert import MarkdownExporter
from traitlets.config import Config

from vehicle_detection import command_line
from vehicle_detection.media.files import write_whole

# The outputs of cells with this tag are left out: embedded videos.
LEFT_OUT = "video"
_WIDGET = "application/vnd.jupyter.widget-view+json"
_JPEG_QUALITY = 80
_WIDEST = 1400
# nbconvert indents what a cell prints, which some readers take for prose.
_FENCED_OUTPUT = """{%- extends 'markdown/index.md.j2' -%}
{% block stream %}
```text
{{ output.text | trim }}
```
{% endblock stream %}
"""


def small_jpeg(png):
    """A PNG's content as that of a JPEG, made smaller if it is wide."""
    img = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    scale = min(1, _WIDEST / img.shape[1])
    img = cv2.resize(img, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", img, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def without_what_moves(notebook):
    """The notebook without progress bars, which are in the error stream, and without widgets."""
    for cell in notebook.cells:
        if "outputs" in cell:
            cell.outputs = [
                one for one in cell.outputs
                if one.get("name") != "stderr" and _WIDGET not in one.get("data", {})
            ]  # fmt: skip
    return notebook


def convert(notebook, path):
    """Write an executed notebook as Markdown, and its pictures into a folder beside it."""
    config = Config()
    config.TagRemovePreprocessor.enabled = True
    config.TagRemovePreprocessor.remove_all_outputs_tags = (LEFT_OUT,)
    config.TagRemovePreprocessor.remove_cell_tags = ("injected-parameters",)
    folder = path.with_suffix("").name
    exporter = MarkdownExporter(config=config, raw_template=_FENCED_OUTPUT)
    text, resources = exporter.from_notebook_node(
        without_what_moves(nbformat.read(notebook, as_version=4)),
        resources={"output_files_dir": f"{folder}_files"},
    )
    text = text.replace(f"{Path.cwd()}/", "")
    for name, content in resources["outputs"].items():
        jpeg = Path(name).with_suffix(".jpg")
        write_whole(path.parent / jpeg, small_jpeg(content))
        text = text.replace(name, str(jpeg))
    write_whole(path, text)


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.executed",
        description=__doc__.splitlines()[0],
        epilog="example: %(prog)s output/two_stage.ipynb docs/two_stage.md",
    )
    parser.add_argument("notebook", type=Path)
    parser.add_argument("path", type=Path, help="Markdown file to write")
    arguments = parser.parse_args()
    convert(arguments.notebook, arguments.path)


if __name__ == "__main__":
    command_line.run(main)
