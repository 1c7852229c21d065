"""Executes the notebooks and stores them with their outputs. Pictures are reduced to a palette, progress is left out.

    python python/store_notebooks.py [NAME…]

Needs the package with its extra `all`, and the dependency groups `notebooks` and `mitsuba` of pyproject.toml.
"""

import base64
import io
import pathlib
import shutil
import sys
import tempfile
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
# Charts have few colours; pictures of scenes have many, and are dithered.
FEW, MANY = 96, 256
LIMIT_S = 600


def stored(path: pathlib.Path, folder: pathlib.Path) -> str:
    """The text of a notebook after its execution in a folder."""
    book = nbformat.read(path, as_version=4)
    NotebookClient(book, timeout=LIMIT_S, resources={"metadata": {"path": str(folder)}}).execute()
    for cell in book.cells:
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [kept(output) for output in cell.outputs if is_kept(output)]
    book.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    return f"{nbformat.writes(book, version=4)}\n"


def is_kept(output: Any) -> bool:
    is_progress = "of the work" in output.get("data", {}).get("text/plain", "")
    return not is_progress and output.get("name") != "stderr"


def kept(output: Any) -> Any:
    output.get("metadata", {}).clear()
    if picture := output.get("data", {}).get("image/png"):
        output.data["image/png"] = reduced(picture)
    return output


def reduced(picture: str) -> str:
    """A picture with a palette, which takes a third of the space."""
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    # Without metadata, which name the versions of packages.
    out = io.BytesIO()
    if is_scene(image):
        image = image.quantize(MANY, Image.Quantize.MEDIANCUT, dither=Image.Dither.FLOYDSTEINBERG)
    else:
        image = image.quantize(FEW, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    image.save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode("ascii")


def is_scene(image: Image.Image) -> bool:
    return image.getcolors(maxcolors=5000) is None


def main() -> None:
    names = sys.argv[1:] or [path.stem for path in sorted((HERE / "notebooks").glob("*.ipynb"))]
    with tempfile.TemporaryDirectory() as checkout:
        # They share a farm's folder, which is deleted at the end.
        folder = pathlib.Path(checkout, "python", "notebooks")
        folder.mkdir(parents=True)
        shutil.copytree(HERE.parent / "examples", pathlib.Path(checkout, "examples"))
        for name in names:
            path = HERE / "notebooks" / f"{name}.ipynb"
            text = stored(path, folder)
            path.write_text(text, encoding="utf-8")
            print(f"{path.name}: {len(text.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
