"""The language models: their text, how it is cut, and what they learn."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy import finish

from dropout_uncertainty.data_efficiency.hidden_state import language
from dropout_uncertainty.data_efficiency.hidden_state.language import CONFIGS, LanguageConfig, encoded, sequences, text
from dropout_uncertainty.errors import UserError

SMALL = {"train": 300, "test": 150, "width": 8, "batch": 3, "length": 20, "passes": 3}


def small(masks="held"):
    return replace(CONFIGS[f"hidden/language-{masks}"], **SMALL)


def test_the_text_is_read_as_it_is_and_an_altered_one_is_refused(tmp_path):
    whole = text()
    assert len(whole) == 465_048
    numbers, alphabet = encoded()
    assert "".join(alphabet[n] for n in numbers[:200]) == whole[:200]
    (tmp_path / "topics.txt.gz").write_bytes(b"no gzip")
    with pytest.raises(UserError, match="cannot be read"):
        text(tmp_path / "topics.txt.gz")
    with pytest.raises(UserError, match="cannot be read"):
        text(tmp_path / "none.gz")


def test_sequences_by_hand():
    """Two rows that go on where they ended; what comes next is one character later."""
    (first, second) = sequences(torch.arange(14), batch=2, length=3)
    assert first[0].tolist() == [[0, 1, 2], [6, 7, 8]]
    assert first[1].tolist() == [[1, 2, 3], [7, 8, 9]]
    assert second[0].tolist() == [[3, 4, 5], [9, 10, 11]]


def test_before_training_a_character_surprises_as_much_as_any():
    process = language.start(small("none"), (100, 101))
    with torch.no_grad():
        process.net.to_output.zero_()
    assert process._assess(process.test).tolist() == pytest.approx([np.log(len(encoded()[1]))] * 2, rel=1e-5)


@pytest.mark.parametrize("masks", language.MASKS)
def test_a_model_learns_and_resumed_is_whole(masks):
    whole = finish(language.start(small(masks), (100, 101), precision="float64")).result()
    assert (whole["train"][:, -1] < whole["train"][:, 0]).all()
    begun, rest = (language.start(small(masks), (100, 101), precision="float64") for _ in range(2))
    begun.advance()
    rest.restore(begun.state())
    for key, value in finish(rest).result().items():
        assert np.array_equal(value, whole[key]), key
    for key, value in finish(language.start(small(masks), (101,), precision="float64")).result().items():
        assert np.allclose(value[0], whole[key][1], atol=1e-5), key


def test_held_masks_last_for_a_sequence_and_drop_characters():
    process = language.start(small(), (100,))
    seen, kept, _ = process._draw(0)
    assert seen.shape == (1, 3, len(encoded()[1]))
    assert kept.shape == (1, 3, 8)
    assert not torch.equal(kept, process._draw(1)[1])
    assert language.start(small("fresh"), (100,))._draw(0)[1].shape == (1, 3, 20, 8)
    assert language.start(small("none"), (100,))._draw(0) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [({"masks": "some"}, "expected masks out of"), ({"train": 50}, "train and test must be at least")],
)
def test_settings_that_cannot_be_are_refused(change, words):
    with pytest.raises(ValueError, match=words):
        LanguageConfig(**{"masks": "held"} | SMALL | change)
