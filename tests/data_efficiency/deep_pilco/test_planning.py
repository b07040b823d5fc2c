"""Algorithm 4: a system whose moments are known, brute-force particles, exact gradients, held draws, repairs."""

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import torch

from dropout_uncertainty.data_efficiency.deep_pilco import particles, planning, trial_gradient
from dropout_uncertainty.data_efficiency.deep_pilco.dropout_dynamics import DrawnFunction, DropoutDynamics
from dropout_uncertainty.data_efficiency.deep_pilco.particles import Draws
from dropout_uncertainty.data_efficiency.deep_pilco.planning import Planning, RBFShape
from dropout_uncertainty.data_efficiency.plant.cartpole import PAPER, features
from dropout_uncertainty.data_efficiency.plant.cost import cost
from dropout_uncertainty.data_efficiency.policies import force
from dropout_uncertainty.rng import generator

PLANT = replace(PAPER, steps=5, solved_steps=2)
SHAPE = RBFShape(6)
SPREAD = (1.0, 2.0, 4.0, 0.7, 0.7)
PLAN = Planning(particles=8, policy_steps=4)


def normal(*shape, name="normal"):
    return torch.randn(*shape, generator=generator(100, name), dtype=torch.float64)


def model(seeds=(100, 101), **options):
    """Return networks that move the pole: untrained, their outputs made larger."""
    made = DropoutDynamics(seeds, **{"hidden": (16, 16), "drop": 0.25, "dtype": torch.float64, **options})
    made.target_std = made.target_std * 0.5
    return made


def policies(seeds=(100, 101), weight_std=0.5):
    return torch.stack([SHAPE.initial(SPREAD, weight_std, generator(seed, "policy")) for seed in seeds])


def draws_of(made, plan=PLAN, *path, plant=PLANT):
    return next(planning.draw(made, plant, plan, plan.particles, *path))


class TestLinearGaussian:
    """A linear system without control keeps Gaussians Gaussian: mean A m and covariance A S A'."""

    A = torch.eye(4, dtype=torch.float64) + 0.3 * normal(4, 4, name="A")

    def predict(self, matching, count=50, steps=5):
        """Return the prediction from whitened particles and noise, whose sample moments are exactly 0 and I."""
        white = normal(1, steps + 1, count, 4)
        white = white - white.mean(-2, keepdim=True)
        factor = torch.linalg.cholesky(white.mT @ white / count)
        white = white @ torch.linalg.inv(factor).mT
        self.start = torch.tensor(PLANT.start_mean, dtype=torch.float64) + 0.2 * white[:, 0]
        change = torch.cat((self.A.T - torch.eye(4), torch.zeros(1, 4)))[None]  # rows: the state, then the force
        function = DrawnFunction((change,), (torch.zeros(1, 1, 4).double(),), angle_features=False)
        policy = SHAPE.policy(policies((100,)))
        draws = Draws(self.start, (function,), white[:, 1:])
        return particles.predict(policy, replace(PLANT, steps=steps), draws, matching)

    def test_full_matching_gives_the_exact_moments(self):
        found = self.predict("full")
        mean, cov = torch.tensor(PLANT.start_mean, dtype=torch.float64), 0.04 * torch.eye(4, dtype=torch.float64)
        for t in range(5):
            mean, cov = self.A @ mean, self.A @ cov @ self.A.T
            torch.testing.assert_close(found.mean[0, t], mean, rtol=1e-9, atol=1e-9)
            torch.testing.assert_close(found.variance[0, t], cov.diagonal(), rtol=1e-4, atol=1e-4)
            sample = found.particles[0, t] - found.particles[0, t].mean(0)
            torch.testing.assert_close(sample.mT @ sample / 50, cov, rtol=1e-4, atol=1e-4)

    def test_diagonal_matching_forgets_the_correlations(self):
        found = self.predict("diagonal")
        variance = torch.full((4,), 0.04, dtype=torch.float64)
        for t in range(5):
            variance = (self.A @ torch.diag(variance) @ self.A.T).diagonal()
            torch.testing.assert_close(found.variance[0, t], variance, rtol=1e-4, atol=1e-4)

    def test_without_matching_each_particle_goes_its_own_way(self):
        found = self.predict("off")
        expected = self.start @ torch.linalg.matrix_power(self.A, 5).T
        torch.testing.assert_close(found.particles[:, -1], expected, rtol=1e-9, atol=1e-9)


def particle_by_particle(made, masks, policy, start, noise, matching):
    """Return means, variances and particles of one replica, in loops over particles and NumPy moments."""
    states, means, variances, visited = start.clone(), [], [], []
    for t in range(PLANT.steps):
        moved = []
        for k in range(len(states)):
            u = force(policy, PLANT, states[None, k])
            x = torch.cat((features(states[k]), u))[None, None]
            one = tuple(m if m is None else m[:, k : k + 1] for m in masks)
            y = made.net((x - made.input_mean) / made.input_std, one) * made.target_std + made.target_mean
            moved.append((states[k] + y[0, 0]).detach().numpy())
        moved = np.array(moved)
        cov = np.cov(moved.T, bias=True)
        means.append(moved.mean(0))
        variances.append(cov.diagonal())
        if matching == "full":
            variance = cov.diagonal()
            cov = cov + np.diag(particles.JITTER + particles.RELATIVE_JITTER * variance)
            moved = moved.mean(0) + noise[t].numpy() @ np.linalg.cholesky(cov).T
        elif matching == "diagonal":
            moved = moved.mean(0) + noise[t].numpy() * np.sqrt(cov.diagonal() + particles.JITTER)
        states = torch.from_numpy(moved)
        visited.append(moved)
    return np.array(means), np.array(variances), np.array(visited)


@pytest.mark.parametrize("matching", particles.MATCHING)
def test_predictions_equal_particles_moved_one_by_one(matching):
    made = model((100,))
    draws, policy = draws_of(made, PLAN, 3), SHAPE.policy(policies((100,)))
    found = particles.predict(policy, PLANT, draws, matching)
    masks = made.draw(PLAN.particles, 3)
    expected = particle_by_particle(made, masks, policy, draws.start[0], draws.noise[0], matching)
    for got, want in zip((found.mean, found.variance, found.particles), expected, strict=True):
        np.testing.assert_allclose(got[0].detach().numpy(), want, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(found.costs(PLANT)[0], cost(PLANT, torch.from_numpy(expected[2])).mean(-1))


@pytest.mark.parametrize(
    ("matching", "cost_of", "hold"),
    [("full", "particles", True), ("diagonal", "mean", False), ("off", "particles", True)],
)
def test_gradients_equal_finite_differences_under_fixed_draws(matching, cost_of, hold):
    plan = replace(PLAN, matching=matching, cost_of=cost_of, hold_masks=hold)
    made, parameters = model(activation="sigmoid"), policies()
    draws = draws_of(made, plan)

    def value(x):
        return planning.objective(PLANT, SHAPE, plan, x, draws)

    _, gradient = value(parameters)
    for number in range(3):
        direction, h = normal(2, SHAPE.size, name=f"direction {number}"), 1e-6
        slope = (value(parameters + h * direction)[0] - value(parameters - h * direction)[0]) / (2 * h)
        torch.testing.assert_close((gradient * direction).sum(1), slope, rtol=1e-5, atol=1e-8)


def by_autograd(plan, parameters, draws):
    """Return what `planning.objective` returns, by autograd through `particles.predict`."""
    leaf = parameters.clone().requires_grad_()
    value = particles.predict(SHAPE.policy(leaf), PLANT, draws, plan.matching).costs(PLANT).mean(-1)
    return value.detach(), torch.autograd.grad(value.sum(), leaf)[0]


@pytest.mark.parametrize("hidden", [(16,), (16, 12)])
@pytest.mark.parametrize(("activation", "hold"), [("relu", True), ("relu", False), ("sigmoid", True)])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-11), (torch.float32, 2e-3)])
def test_the_gradient_by_hand_is_that_of_autograd(hidden, activation, hold, dtype, tolerance):
    plan = replace(PLAN, hold_masks=hold)
    made, parameters = model(hidden=hidden, activation=activation, dtype=dtype), policies().to(dtype)
    draws = draws_of(made, plan)
    assert trial_gradient.covers(draws, plan.matching, plan.cost_of)
    value, gradient = planning.objective(PLANT, SHAPE, plan, parameters, draws)
    expected_value, expected = by_autograd(plan, parameters, draws)
    torch.testing.assert_close(value, expected_value, rtol=tolerance, atol=0)
    assert ((gradient - expected).norm(dim=1) < tolerance * expected.norm(dim=1)).all()


def test_a_covariance_without_factor_spoils_its_replica_alone():
    made, parameters = model(), policies()
    draws = draws_of(made)
    expected = by_autograd(PLAN, parameters, draws)
    draws.noise[1, 2] = torch.nan
    for got, want in zip(planning.objective(PLANT, SHAPE, PLAN, parameters, draws), expected, strict=True):
        torch.testing.assert_close(got[0], want[0])
        assert got[1].isnan().all()


@pytest.mark.parametrize(
    ("change", "options"),
    [
        ({"matching": "diagonal"}, {}), ({"matching": "off"}, {}), ({"cost_of": "mean"}, {}),
        ({}, {"angle_features": False}), ({}, {"input_drop": 0.25}),
    ],
)  # fmt: skip
def test_other_settings_are_left_to_autograd(change, options):
    plan = replace(PLAN, **change)
    assert not trial_gradient.covers(draws_of(model(**options), plan), plan.matching, plan.cost_of)


def test_masks_are_held_for_the_trial_or_redrawn_each_step():
    made = model()
    held, redrawn = draws_of(made), draws_of(made, replace(PLAN, hold_masks=False))
    assert len(held.functions) == 1
    assert len(redrawn.functions) == PLANT.steps
    x = normal(2, 8, 6)
    changes = [function(x) for function in redrawn.functions]
    assert not any(torch.equal(a, b) for a, b in itertools.combinations(changes, 2))


@pytest.mark.parametrize("every", [1, 3, 0])
def test_particles_and_masks_are_fresh_when_due_only(every):
    plan, made = replace(PLAN, redraw_every=every), model()
    draws = list(itertools.islice(planning._stream(made, PLANT, plan, 7), 23))
    for step in range(1, 23):
        kept = every == 0 or step % every != 0
        assert torch.equal(draws[step].start, draws[step - 1].start) == kept
        bias, before = (draws[i].functions[0].biases[0] for i in (step, step - 1))
        assert torch.equal(bias, before) == kept


def test_noise_is_standardised_over_the_particles():
    noise = draws_of(model(), replace(PLAN, particles=30)).noise
    torch.testing.assert_close(noise.mean(2), torch.zeros(2, 5, 4).double(), rtol=0, atol=1e-12)
    torch.testing.assert_close(noise.square().mean(2), torch.ones(2, 5, 4).double())
    plain = draws_of(model(), replace(PLAN, particles=30, standard_noise=False)).noise
    assert plain.mean(2).abs().max() > 0.1


def test_particles_start_from_the_start_distribution():
    plan = replace(PLAN, particles=4000)
    start = draws_of(model((100,)), plan).start[0]
    np.testing.assert_allclose(start.mean(0), PLANT.start_mean, atol=4 * 0.02 / 4000**0.5)
    np.testing.assert_allclose(start.std(0), 0.02, rtol=0.06)


@pytest.mark.parametrize("optimiser", planning.OPTIMISERS)
def test_the_policy_improves(optimiser, monkeypatch):
    """A particle that moves as it is pushed is to be brought under the goal: swing-up reduced to a cart."""
    change = torch.zeros(2, 5, 4, dtype=torch.float64)
    change[:, 4, 0] = 0.05  # the force moves the cart
    start = torch.zeros(2, 8, 4, dtype=torch.float64)
    start[..., 0] = 0.5 + 0.1 * normal(2, 8)
    noise, still = normal(2, 5, 8, 4), torch.zeros(2, 1, 4, dtype=torch.float64)

    def fixed(made, *_, **__):
        rows = [seed - 100 for seed in made.seeds]
        function = DrawnFunction((change[rows],), (still[rows],), angle_features=False)
        yield Draws(start[rows], (function,), noise[rows])

    monkeypatch.setattr(planning, "draw", fixed)
    plan = replace(PLAN, optimiser=optimiser, policy_steps=30, policy_rate=0.05, redraw_every=0)
    before, _ = planning.objective(PLANT, SHAPE, plan, policies(), next(fixed(model())))
    found = planning.improve(model(), PLANT, SHAPE, plan, policies())
    after, _ = planning.objective(PLANT, SHAPE, plan, found.parameters, next(fixed(model())))
    assert (after < before - 0.1).all()
    assert found.repairs.tolist() == [0, 0]


def test_a_replica_alone_equals_the_same_among_others():
    seeds = tuple(range(100, 110))
    many = planning.improve(model(seeds), PLANT, SHAPE, PLAN, policies(seeds), 1)
    alone = planning.improve(model((106,)), PLANT, SHAPE, PLAN, policies((106,)), 1)
    torch.testing.assert_close(alone.parameters[0], many.parameters[6], rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(alone.value[0], many.value[6], rtol=1e-9, atol=1e-9)


def test_a_gradient_that_is_not_finite_is_left_out_and_counted():
    made, sound = model(), model()
    made.target_mean = made.target_mean.clone()
    made.target_mean[1] = math.inf
    found = planning.improve(made, PLANT, SHAPE, PLAN, policies(), 1)
    expected = planning.improve(sound, PLANT, SHAPE, PLAN, policies(), 1)
    assert found.repairs.tolist() == [0, PLAN.policy_steps]
    torch.testing.assert_close(found.parameters[0], expected.parameters[0])
    assert torch.equal(found.parameters[1], policies()[1])


def test_the_gradient_of_each_replica_is_limited():
    made, plan = model(), replace(PLAN, policy_steps=1, clip=1e-9)
    found = planning.improve(made, PLANT, SHAPE, plan, policies(), 1)
    # Adam divides by the gradient's size; one this small is comparable with its epsilon and moves little
    assert ((found.parameters - policies()).abs().max(1).values < 0.2 * plan.policy_rate).all()


def test_threads_do_not_share_the_arrays_of_a_trial():
    key = torch.Size((1, 2, 3, 4)), 5, (6,), torch.float64, torch.device("cpu")
    here = trial_gradient._Trial.kept(*key)
    with ThreadPoolExecutor(1) as other:
        assert other.submit(trial_gradient._Trial.kept, *key).result() is not here
    assert trial_gradient._Trial.kept(*key) is here


class TestGuard:
    def search(self, values, above=0.9):
        """Return the outcome where successive searches reach the given costs; the parameters tell which was kept."""
        calls = []

        def improve(rows, parameters, attempt):
            calls.append((list(rows), attempt))
            reached = torch.tensor([values[attempt][row] for row in rows], dtype=torch.float64)
            return planning.Improved(parameters.clone(), reached, torch.zeros(len(reached)).long())

        first, *fresh = (torch.full((3, SHAPE.size), float(i), dtype=torch.float64) for i in range(3))
        best, redraws = planning.guarded(improve, first, fresh, above)
        return best.parameters[:, 0].tolist(), best.value.tolist(), redraws.tolist(), calls

    def test_only_hopeless_policies_are_redrawn_and_the_better_is_kept(self):
        kept, value, redraws, calls = self.search({0: [0.5, 0.95, 0.99], 1: [0.0, 0.6, 1.0], 2: [0.0, 0.0, 0.97]})
        assert kept == [0, 1, 2]
        assert value == [0.5, 0.6, 0.97]
        assert redraws == [0, 1, 2]
        assert calls == [([0, 1, 2], 0), ([1, 2], 1), ([2], 2)]

    def test_a_policy_without_a_value_is_redrawn(self):
        kept, *_ = self.search({0: [0.5, 0.5, math.nan], 1: [0, 0, 0.8], 2: [0, 0, 0.7]})
        assert kept == [0, 0, 1]

    def test_a_redraw_without_a_value_is_not_kept(self):
        kept, value, *_ = self.search({0: [0.5, 0.5, 0.99], 1: [0, 0, math.nan], 2: [0, 0, math.nan]})
        assert (kept, value) == ([0, 0, 0], [0.5, 0.5, 0.99])

    def test_a_good_policy_is_not_redrawn(self):
        _, _, redraws, calls = self.search({0: [0.5, 0.5, 0.5]})
        assert redraws == [0, 0, 0]
        assert len(calls) == 1


def test_first_policies_cover_the_states_around_the_hanging_pole():
    shape = RBFShape(400)
    policy = shape.policy(shape.initial(SPREAD, 0.5, generator(100))[None])
    np.testing.assert_allclose(policy.centres[0].mean(0), [0, 0, 0, 0, -1], atol=0.5)
    np.testing.assert_allclose(policy.centres[0].std(0), SPREAD, rtol=0.15)
    np.testing.assert_allclose(policy.log_length_scales[0, 0].exp(), SPREAD)
    assert policy.weights.std() == pytest.approx(0.5, rel=0.15)


@pytest.mark.parametrize("angle_features", [True, False])
def test_particles_are_steered_as_the_real_cart(angle_features):
    policy, states = SHAPE.policy(policies()), 2 * normal(2, 9, 4)
    got = particles.act(states, *particles.multiplied_out(policy), 10.0, angle_features)
    torch.testing.assert_close(got[..., -1], force(policy, PLANT, states), rtol=1e-9, atol=1e-9)
    assert torch.equal(got[..., :-1], features(states) if angle_features else states)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"matching": "none"}, "matching to be one of full, diagonal, off, got 'none'"),
        ({"cost_of": "median"}, "cost_of to be one of"),
        ({"optimiser": "sgd"}, "optimiser to be one of adam, bfgs"),
        ({"particles": 1}, "particles must be at least 2, got 1"),
        ({"policy_steps": 0}, "policy_steps must be at least 1"),
        ({"clip": -1.0}, "^clip must be at least 0, got -1.0$"),
        ({"policy_final_rate": 2.0}, "policy_final_rate must lie in"),
        ({"optimiser": "bfgs"}, "set redraw_every to 0"),
    ],
)
def test_bad_plans_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        replace(PLAN, **change)
