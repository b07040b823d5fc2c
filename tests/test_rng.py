import numpy as np
import pytest
import torch

from dropout_uncertainty import rng


def draw(generator):
    return torch.rand(4, generator=generator)


def test_a_stream_is_a_function_of_seed_and_path():
    assert torch.equal(draw(rng.generator(3, "masks", 7)), draw(rng.generator(3, "masks", 7)))
    others = [rng.generator(4, "masks", 7), rng.generator(3, "masks", 8), rng.generator(3, "init", 7), rng.generator(3)]
    first = draw(rng.generator(3, "masks", 7))
    assert all(not torch.equal(first, draw(other)) for other in others)


def test_names_and_numbers_are_different_paths():
    assert not torch.equal(draw(rng.generator(1, "2")), draw(rng.generator(1, 2)))


def test_stacked_gives_a_replica_the_same_numbers_in_any_company():
    together = rng.stacked(draw, [5, 6, 7], "data")
    assert together.shape == (3, 4)
    assert torch.equal(together[1:2], rng.stacked(draw, [6], "data"))


@pytest.mark.parametrize("seed", [-1, 1.5, True, "3"])
def test_bad_seeds_are_refused(seed):
    with pytest.raises((ValueError, TypeError), match=r"seed|type"):
        rng.generator(seed)


def test_seeds_of_replicas_are_made_plain():
    for given in (np.arange(3), range(3), iter([0, 1, 2]), torch.arange(3), (np.uint8(0), 1, 2)):
        plain = rng.check_seeds(given)
        assert plain == (0, 1, 2)
        assert {type(seed) for seed in plain} == {int}
    for wrong in (5, [], [0, 0], [-1], [1.0], [True], ["1"], None):
        with pytest.raises((ValueError, TypeError), match="seed"):
            rng.check_seeds(wrong)


def test_integers_of_numpy_name_the_same_streams():
    mine, theirs = rng.generator(100, "step", 3), rng.generator(np.int64(100), "step", np.int32(3))
    assert mine.initial_seed() == theirs.initial_seed() == rng.derived(100, "step", 3)
