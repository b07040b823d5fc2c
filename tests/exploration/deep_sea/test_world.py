"""Deep Sea: bsuite's recorded moves, and what the rules say by hand."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from dropout_uncertainty.exploration.deep_sea.world import DeepSea, cell_count, cell_number, random_mapping

GOLDEN = Path(__file__).parents[2] / "golden" / "deep_sea_trace.json.gz"


@pytest.fixture(scope="module")
def cases():
    return json.loads(gzip.decompress(GOLDEN.read_bytes()))["cases"]


@pytest.mark.parametrize("number", range(4))
def test_moves_as_bsuite_does(cases, number):
    case = cases[number]
    sea, found, bad = DeepSea(np.array([case["mapping"]])), 0, 0
    assert (sea.size, len(case["episodes"])) == (case["size"], 20)
    for episode in case["episodes"]:
        sea.reset()
        treasure = False
        observations = episode["observations"]
        steps = zip(episode["actions"], episode["rewards"], episode["last"], observations[1:], strict=True)
        assert [[sea.row, sea.column[0]]] == observations[0]
        for action, reward, last, observation in steps:
            got, finds = sea.step(np.array([action]))
            np.testing.assert_allclose(got, [reward], rtol=0, atol=1e-15)
            assert sea.over == last
            assert observation == ([] if last else [[sea.row, sea.column[0]]])
            treasure |= finds[0]
        found, bad = found + treasure, bad + (not treasure)
        assert (bad, found) == (episode["bad_episodes"], episode["denoised_return"])
    assert found > 0 or case["size"] == 10  # treasure and failure both are in the trace
    assert bad > 0


def test_replicas_move_by_their_own_maps():
    mapping = random_mapping(4, (100, 101, 102))
    sea = DeepSea(mapping)
    total = np.zeros(3)
    for row in range(4):
        right = mapping[:, row, row]
        assert (sea.column == [row, row, 0]).all()
        reward, found = sea.step(np.array([right[0], right[1], 1 - mapping[2, row, 0]]))
        total += reward
    np.testing.assert_array_equal(found, [True, True, False])
    np.testing.assert_allclose(total, [0.99, 0.99, 0.0])  # the costs of all moves to the right are 0.01


def test_cells_that_can_be_reached_are_numbered_without_gaps():
    numbers = [cell_number(row, np.arange(row + 1)) for row in range(6)]
    np.testing.assert_array_equal(np.concatenate(numbers), np.arange(cell_count(6)))


def test_maps_are_random_and_belong_to_their_seed():
    maps = random_mapping(20, range(100, 120))
    assert abs(maps.mean() - 0.5) < 4 * 0.5 / maps.size**0.5
    np.testing.assert_array_equal(random_mapping(20, [107])[0], maps[7])
    assert (random_mapping(5, [100]) != maps[:1, :5, :5]).any()


def test_misuse_is_named():
    with pytest.raises(ValueError, match=r"expected a mapping \[R, N, N\] of actions 0 and 1, got shape \(1, 4, 3\)"):
        DeepSea(np.zeros((1, 4, 3), dtype=int))
    with pytest.raises(ValueError, match="of actions 0 and 1"):
        DeepSea(np.full((1, 4, 4), 2))
    sea = DeepSea(random_mapping(2, [100]))
    sea.step(np.array([0]))
    sea.step(np.array([0]))
    with pytest.raises(ValueError, match="has 2 moves and is over: call reset first"):
        sea.step(np.array([0]))
