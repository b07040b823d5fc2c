import base64
import hashlib

from dropout_uncertainty.page import dark_pages
from dropout_uncertainty.page.dark_pages import KEY, offer, taken_out


def encoded(words):
    return base64.b64encode(words).decode()


def test_the_second_picture_of_a_cell_lies_beside_the_first_on_its_page(tmp_path):
    name, held = hashlib.sha256(b"light").hexdigest(), tmp_path / "dark"
    bundle = {"data": {"image/png": encoded(b"light")}, "metadata": {"image/png": {"width": 3, KEY: encoded(b"dark")}}}
    plain = {"data": {"image/png": encoded(b"other")}, "metadata": {}}
    notebook = taken_out({"cells": [{"source": ""}, {"outputs": [bundle, plain, {"text": "words"}]}]}, held)
    assert notebook["cells"][1]["outputs"][0]["metadata"] == {"image/png": {"width": 3}}
    assert [file.name for file in held.iterdir()] == [f"{name}.png"]

    page = tmp_path / "html" / "api" / "page.html"
    for folder in (page.parent, tmp_path / "html" / "_images"):
        folder.mkdir(parents=True)
    other = '<img alt="x" src="../_images/abc.png"/>'
    page.write_text(f'<p><img alt="a curve" class="align-left" src="../_images/{name}.png" width="3"/>{other}</p>')
    offer(tmp_path / "html", held)
    text = page.read_text()
    assert text.count('alt="a curve"') == text.count('width="3"') == 2
    assert f'<img alt="a curve" class="by-day align-left" src="../_images/{name}.png"' in text
    second = f'alt="a curve" class="by-night dark-light align-left" src="../_images/{name}-dark.png"'
    assert f'<img loading="lazy" {second}' in text
    assert other in text
    assert (tmp_path / "html" / "_images" / f"{name}-dark.png").read_bytes() == b"dark"


def test_figures_are_drawn_twice_only_for_the_book(monkeypatch):
    from matplotlib.figure import Figure

    from dropout_uncertainty.page.plotting import small_png

    figure = Figure()
    figure.add_subplot().plot([0, 1], color="black")
    assert set(small_png(figure)[1]) == {"width", "height"}
    monkeypatch.setenv(dark_pages.TWICE, "1")
    light, metadata = small_png(figure)
    assert metadata[KEY] not in (None, light)
