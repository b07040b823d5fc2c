import dataclasses
from pathlib import Path

import numpy as np
import pytest
from IPython.core.formatters import DisplayFormatter

from dropout_uncertainty.page.tables import Table, Words, provenance
from dropout_uncertainty.runs import records
from dropout_uncertainty.settings import config_dict, config_hash


@dataclasses.dataclass
class Config:
    rounds: int = 3


@pytest.fixture
def two_records(tmp_path):
    found = []
    for seeds, commit, hours in (([100, 101, 102], "a" * 40, 1.5), ([105], "b" * 40, 0.5)):
        origin = {
            "commit": commit,
            "dirty": commit[0] == "b",
            "date": "2026-01-0" + str(len(seeds)) + "T00:00:00+00:00",
        }
        header = {
            "experiment": "toy",
            "name": "ours",
            "seeds": seeds,
            "config": config_dict(Config()),
            "config_hash": config_hash(Config()),
            "device": "cpu",
            "precision": "float32",
            "provenance": {**origin, "processor": "a machine", "wall_s": hours * 3600},
        }
        path = tmp_path / "toy" / "ours" / f"{records.file_name(seeds, 'cpu')}.npz"
        found.append(records.write(path, {"x": np.zeros(len(seeds))}, header))
    return found


def test_named_table_is_a_numbered_directive_in_the_book():
    bundle = Table([["a", 1.5], ["b|c", None]], ["row", "value"], "A caption.", "tab-5-1")._repr_mimebundle_()
    assert bundle["text/markdown"].splitlines() == [
        "```{table} A caption.",
        ":name: tab-5-1",
        "",
        "| row | value |",
        "| :--- | ---: |",
        "| a | 1.5 |",
        "| b\\|c | – |",
        "```",
    ]


def test_table_on_the_screen_is_html_with_its_markdown_rendered_and_its_html_escaped():
    html = Table([["**bold**", "<script>"]], ["x", "y"], "A *caption*.")._repr_mimebundle_()["text/html"]
    assert "<strong>bold</strong>" in html
    assert "<script>" not in html
    assert "caption" in html


def test_what_has_nothing_to_say_shows_nothing():
    show = DisplayFormatter().format
    assert show(Words("")) == ({}, {})
    assert show(Words("A *word*."))[0]["text/markdown"] == "A *word*."


def test_table_refuses_a_row_of_another_length():
    with pytest.raises(ValueError, match="2 columns got a row of 1 cells"):
        Table([["a"]], ["x", "y"])


def test_provenance_sums_up_its_records(two_records):
    text = provenance(two_records).markdown
    line = text.splitlines()[0]
    for part in ("profile recorded", "seeds 100-102,105", "2026-01-01 to 2026-01-03", "a machine", "2.0 h"):
        assert part in line
    assert "aaaaaaaa, bbbbbbbb with changes" in line
    assert "dropout-uncertainty run toy --config ours --seeds 100-102,105" in text
    assert '"rounds": 3' in text
    assert "`toy/ours/100-102.npz`" in text


def test_provenance_folds_on_the_screen_too(two_records):
    html = provenance(two_records, "quick").html
    assert html.startswith("<details><summary>Where these numbers come from: profile quick")


def test_provenance_needs_a_record():
    with pytest.raises(ValueError, match="at least one record"):
        provenance([])


def test_record_without_repository_says_so(two_records):
    header = two_records[0].header
    header["provenance"]["commit"] = None
    nowhere = dataclasses.replace(two_records[0], header=header, path=Path("x.npz"))
    assert "commit unknown" in provenance([nowhere]).markdown


def test_settings_within_a_cell_are_words():
    settings = [{"policy": "thompson", "drop": [0.0, 0.2]}, {"policy": "greedy", "drop": []}]
    table = Table([["agents", settings]], ["field", "value"])
    assert "policy thompson, drop [0.0,\u00a00.2]; policy greedy, drop []" in table.markdown
