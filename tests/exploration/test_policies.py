"""Policies, by hand and by counting; Thompson sampling on a bandit."""

import numpy as np
import pytest

from dropout_uncertainty.exploration.policies import (
    POLICIES,
    AnnealedThompson,
    Boltzmann,
    Chance,
    EpsilonGreedy,
    Greedy,
    Thompson,
    policy,
)

Q = np.array([0.3, 0.1, 0.9, 0.9, 0.2])


def chance(count, seed=100):
    rng = np.random.default_rng(seed)
    return Chance(rng.random(count), rng.random(count), rng.gumbel(size=(count, 5)))


def frequencies(choose, tick, count=40_000):
    actions = choose(np.tile(Q, (count, 1)), chance(count), tick)
    return np.bincount(actions, minlength=5) / count


@pytest.mark.parametrize(("tick", "epsilon"), [(1, 1.0), (3001, 1.0), (101_501, 0.5), (190_150, 0.05), (900_000, 0.05)])
def test_epsilon_follows_the_schedule_of_the_demo(tick, epsilon):
    assert EpsilonGreedy().epsilon(tick) == pytest.approx(epsilon, abs=1e-5)
    assert frequencies(EpsilonGreedy(), tick)[2] == pytest.approx(1 - epsilon + epsilon / 5, abs=0.01)


@pytest.mark.parametrize("name", POLICIES)
def test_all_policies_act_uniformly_during_the_burn_in(name):
    np.testing.assert_allclose(frequencies(policy(name), 3001), 0.2, atol=0.01)


@pytest.mark.parametrize("choose", [Thompson(), Greedy()])
def test_random_actions_end_when_the_memory_holds_the_burn_in(choose):
    np.testing.assert_allclose(frequencies(choose, 3002), 0.2, atol=0.01)
    np.testing.assert_array_equal(frequencies(choose, 3003), [0, 0, 1, 0, 0])


@pytest.mark.parametrize("tick", [3003, 50_000, 150_000])
def test_boltzmann_samples_the_softmax(tick):
    temperature = Boltzmann().temperature(tick)
    expected = np.exp(Q / temperature) / np.exp(Q / temperature).sum()
    np.testing.assert_allclose(frequencies(Boltzmann(), tick), expected, atol=0.01)


def test_temperature_falls_from_start_to_end_and_stays():
    choose = Boltzmann(burn_in=100, cooling_end=300, start=2.0, end=0.02)
    values = [choose.temperature(tick) for tick in (50, 101, 201, 301, 10_000)]
    assert values == pytest.approx([2.0, 2.0, 0.2, 0.02, 0.02])


def test_who_acts_on_a_draw_of_the_weights():
    assert {name: kind.draws_weights for name, kind in POLICIES.items()} == {
        "epsilon-greedy": False, "thompson": True, "greedy": False, "boltzmann": False, "annealed-thompson": True,
    }  # fmt: skip
    assert issubclass(AnnealedThompson, Boltzmann)


def test_thompson_plays_a_bandit_arm_as_often_as_the_posterior_says_it_is_best():
    # two arms, posterior draws of their values: P(second better) = 1/4 by construction
    rng = np.random.default_rng(100)
    draws = np.zeros((40_000, 2))
    draws[:, 1] = np.where(rng.random(40_000) < 0.25, 1.0, -1.0)
    many = Chance(rng.random(40_000), rng.random(40_000), rng.gumbel(size=(40_000, 2)))
    assert Thompson()(draws, many, 10_000).mean() == pytest.approx(0.25, abs=0.01)
    # while acting on the mean value never tries the second arm
    mean = np.tile(draws.mean(0), (40_000, 1))
    assert EpsilonGreedy(floor=0.0)(mean, many, 10**6).mean() == 0


def test_an_unknown_policy_is_refused():
    with pytest.raises(ValueError, match="unknown policy 'ucb', choose one of"):
        policy("ucb")
