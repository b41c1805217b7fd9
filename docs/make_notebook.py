"""Run examples/notebook.ipynb, and store what its cells show, small, for those who only look at it.

Run `python docs/make_notebook.py` after a change of what a notebook shows; it takes a minute. A
test fails while the stored words differ from those of a run (`words`). A video and the player are
not stored, for they take a megabyte together: the notebook says so.
"""

import io
import re
from base64 import b64decode, b64encode
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

NOTEBOOK = Path(__file__).parent.parent / "examples" / "notebook.ipynb"
WIDTH_PX = 640
"""Largest width of a stored picture."""
COLOURS = 64
"""Colours of a stored picture."""
IN_HTML = re.compile(r"(?<=data:image/png;base64,)[^\"]+")
FOLDER = re.compile(r"/[\w./]*/tmp\w+(?=/)")
"""The folder of the logs, another in each run."""


def executed() -> nbformat.NotebookNode:
    """Return the notebook with what its cells show in full."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    resources = {"metadata": {"path": str(NOTEBOOK.parent)}}
    NotebookClient(notebook, timeout=600, resources=resources).execute()
    return notebook


def small(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return an executed notebook without the times of the run, and with small images.

    Of each output, only one form is kept.
    """
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [_small(output) for output in cell.outputs if _is_stored(output)]
    return notebook


def words(notebook: nbformat.NotebookNode) -> list[list[str]]:
    """Return the words of each cell's stored outputs, which are the same on every machine.

    Numbers may differ in their last digits. They are left out, and so are images.
    """
    of_cells = []
    for cell in notebook.cells:
        outputs = cell.get("outputs", [])
        texts = [_text(output) for output in outputs if _is_stored(output)]
        of_cells.append([re.sub(r"\d[\d.]*", "#", text) for text in texts])
    return of_cells


def _is_stored(output: nbformat.NotebookNode) -> bool:
    """Whether an output is stored: neither a video nor the player."""
    html = output.get("data", {}).get("text/html", "")
    return "image/webp" not in html and "<iframe" not in html


def _small(output: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return an output as it is stored."""
    if "traceback" in output:
        return output
    data = output.data
    if "image/png" in data:
        output.data = {"image/png": _small_picture(data["image/png"])}
    else:
        html = IN_HTML.sub(lambda picture: _small_picture(picture[0]), data["text/html"])
        output.data = {"text/html": FOLDER.sub("logs", html)}
    return output


def _small_picture(png: str) -> str:
    """Return a picture in base64 with fewer pixels and colours."""
    picture = Image.open(io.BytesIO(b64decode(png))).convert("RGB")
    picture.thumbnail((WIDTH_PX, WIDTH_PX))
    file = io.BytesIO()
    few = picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE)  # keeps the hue of a thin line
    few.save(file, "PNG", optimize=True)
    return b64encode(file.getvalue()).decode()


def _text(output: nbformat.NotebookNode) -> str:
    """Return the text of an output, a word for a picture."""
    if "traceback" in output:
        return "\n".join(output.traceback)
    data = output.data
    if "image/png" in data:
        return "picture"
    return FOLDER.sub("logs", IN_HTML.sub("picture", data["text/html"]))


if __name__ == "__main__":
    nbformat.write(small(executed()), NOTEBOOK)
