"""Figures of the book for dark pages: where they come from and where they lie. They are drawn by `dark_figures`.

A notebook that runs for the book carries the picture for dark pages in the metadata of the other one. The build takes
it out and puts it beside the first, and a style sheet shows the one that fits.
"""

import base64
import hashlib
import re
import shutil
from pathlib import Path
from typing import Any

#: Set in the environment of a notebook whose figures are to be drawn twice.
TWICE = "DROPOUT_UNCERTAINTY_TWICE"
#: Where the second picture stands in the metadata of the first.
KEY = "dark"


def taken_out(notebook: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Take the second pictures out of an executed notebook, as JSON, into files of a folder, and return it without.

    A file is named after the content of the first picture (SHA-256), as MyST-NB will name that one.
    """
    for output in (output for cell in notebook["cells"] for output in cell.get("outputs", ())):
        encoded = output.get("metadata", {}).get("image/png", {}).pop(KEY, None)
        if encoded:
            name = hashlib.sha256(base64.b64decode(output["data"]["image/png"])).hexdigest()
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{name}.png").write_bytes(base64.b64decode(encoded))
    return notebook


def offer(pages: Path, folder: Path) -> None:
    """Put the second pictures that lie in ``folder`` beside the first ones in all pages below ``pages``."""
    for page in pages.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        mended = re.sub(r'<img [^>]*?src="([^"]*_images/)(\w+)\.png"[^>]*>', lambda m: _both(m, pages, folder), text)
        if mended != text:
            page.write_text(mended, encoding="utf-8")


def _both(image: re.Match[str], pages: Path, folder: Path) -> str:
    place, name = image[1], image[2]
    if not (folder / f"{name}.png").exists():
        return image[0]
    shutil.copyfile(folder / f"{name}.png", pages / "_images" / f"{name}-dark.png")
    # the theme puts a light ground below every picture but those of its class dark-light; what is hidden is not loaded
    second = image[0].replace(f"{place}{name}.png", f"{place}{name}-dark.png")
    second = second.replace("<img ", '<img loading="lazy" ', 1)
    return _of_class(image[0], "by-day") + _of_class(second, "by-night dark-light")


def _of_class(image: str, name: str) -> str:
    if ' class="' in image:
        return image.replace(' class="', f' class="{name} ', 1)
    return image.replace("<img ", f'<img class="{name}" ', 1)
