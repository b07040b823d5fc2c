"""Gaussian processes: the original's predictions, likelihoods and derivatives; fitting; clear errors and repairs."""

import math

import pytest
import torch

from dropout_uncertainty.data_efficiency.gaussians import squared_exponential
from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian
from dropout_uncertainty.data_efficiency.pilco import gaussian_process as gp
from dropout_uncertainty.rng import generator


def batched(case):
    """The Gaussian process of a golden case with a replica axis."""
    inducing = case["induce"][None] if case.get("induce", torch.zeros(0)).numel() else None
    return gp.GaussianProcess(case["inputs"][None], case["targets"].T[None], case["hyp"].T[None], inducing)


@pytest.mark.parametrize("key", ["gp0", "gp1"])
def test_prediction_at_a_gaussian_input_matches_the_original(golden, check_moments, key):
    for case in golden(key):
        posterior, repaired = batched(case).posterior()
        assert repaired.sum() == 0

        def predict(m, s, posterior=posterior):
            return tuple(a[0] for a in posterior.moments(Gaussian(m[None], s[None])))

        check_moments(case, predict, case["m"][:, 0], case["s"], ("M", "S", "V"), 1e-9, 1e-7)


def test_likelihood_and_penalty_match_the_original(golden, close):
    for case in golden("gp_nlml"):
        hyper, inputs, targets = case["hyp"].T, case["inputs"][None], case["targets"].T
        value, gradient = gp.negative_log_likelihood(hyper, inputs, targets)
        close(value, case["nlml"], name="nlml")
        close(gradient, case["dnlml"], name="dnlml")
        extra, slope = gp.penalty(hyper, case["curb_std"], case["curb_snr"].item(), case["curb_ls"].item())
        close(value + extra, case["curbed"], name="curbed")
        close(gradient + slope, case["dcurbed"], name="dcurbed")


def test_inducing_likelihood_matches_the_original(golden, close):
    for case in golden("gp1"):
        value, gradient = gp.inducing_negative_log_likelihood(case["induce"][None], batched(case))
        close(value, case["fitc_nlml"], name="fitc_nlml")
        close(gradient, case["fitc_dnlml"], 1e-7, "fitc_dnlml")


def test_blocks_change_no_likelihood(monkeypatch):
    x, y = line(30, replicas=3)
    model = gp.GaussianProcess(x, y, gp.initial_hyper(x, y))
    flat = model.log_hyper.flatten(0, 1), x.repeat_interleave(2, 0), y.flatten(0, 1)
    whole = *gp.negative_log_likelihood(*flat), gp.fit_inducing(model, x[:, :5], 3)[0]
    monkeypatch.setattr(squared_exponential, "BLOCK", {"cpu": 1})
    parts = *gp.negative_log_likelihood(*flat), gp.fit_inducing(model, x[:, :5], 3)[0]
    for got, expected in zip(parts, whole, strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-9, atol=1e-9)


def line(count=40, replicas=2, noise=0.05, seed=100):
    """Noisy values of two functions of three inputs, the third without influence."""
    g = generator(seed)
    x = torch.randn(replicas, count, 3, generator=g, dtype=torch.float64)
    clean = torch.stack((x[..., 0].sin(), x[..., 0] * x[..., 1] / 2), 1)
    return x, clean + noise * torch.randn(clean.shape, generator=g, dtype=torch.float64)


def test_fit_finds_noise_relevance_and_the_function():
    x, y = line(120)
    start = gp.initial_hyper(x, y)
    fitted, found = gp.fit_hyper(x, y, start, 200)
    assert (found.repairs == 0).all()
    noise = fitted[..., -1].exp()
    assert ((noise > 0.035) & (noise < 0.07)).all()
    assert (fitted[..., 2] > fitted[..., 0] + 1).all()  # the third length-scale is much longer than the first
    posterior, _ = gp.GaussianProcess(x, y, fitted).posterior()
    new = line(50, seed=101)[0].clamp(-1.5, 1.5)
    truth = torch.stack((new[..., 0].sin(), new[..., 0] * new[..., 1] / 2), -1)
    assert (posterior(new) - truth).abs().mean() < 0.05


def test_columns_that_do_not_vary_and_a_single_transition_are_fitted():
    x, y = line(30)
    x[..., 1], y[0, 0] = 3.0, 0.5
    fitted, found = gp.fit_hyper(x, y, gp.initial_hyper(x, y), 50)
    assert found.value.isfinite().all()
    assert (found.repairs == 0).all()
    posterior, repaired = gp.GaussianProcess(x, y, fitted).posterior()
    assert repaired.sum() == 0
    values = posterior(x)
    torch.testing.assert_close(values[0, :, 0], y[0, 0], rtol=0, atol=0.01)  # the constant
    torch.testing.assert_close(values[1, :, 0], y[1, 0], rtol=0, atol=0.3)  # learned as ever
    assert gp.initial_inducing(x, 5, [100, 101]).isfinite().all()

    x, y = x[:, :1], y[..., :1]
    hyper = gp.initial_hyper(x, y)
    fitted, _ = gp.fit_hyper(x, y, hyper, 5)
    torch.testing.assert_close(fitted, hyper)
    posterior, _ = gp.GaussianProcess(x, y, fitted).posterior()
    torch.testing.assert_close(posterior(x)[:, 0], y[..., 0], rtol=0.02, atol=0.0)


def test_gradient_by_finite_differences_over_a_batch():
    x, y = line(12, replicas=3)
    hyper = gp.initial_hyper(x, y)[:, 0] + 0.3
    _, gradient = gp.negative_log_likelihood(hyper, x, y[:, 0])
    for i in range(hyper.shape[1]):
        step = torch.zeros_like(hyper)
        step[:, i] = 1e-6
        up, down = (gp.negative_log_likelihood(hyper + sign * step, x, y[:, 0])[0] for sign in (1, -1))
        torch.testing.assert_close((up - down) / 2e-6, gradient[:, i], rtol=1e-5, atol=1e-6)


def test_inducing_inputs_at_all_data_give_the_full_posterior():
    x, y = line(25)
    hyper = gp.initial_hyper(x, y)
    query = Gaussian(x[:, 0] + 0.1, 0.05 * torch.eye(3, dtype=torch.float64).expand(2, 3, 3))
    full, _ = gp.GaussianProcess(x, y, hyper).posterior()
    sparse, _ = gp.GaussianProcess(x, y, hyper, x).posterior()
    for got, expected in zip(sparse.moments(query), full.moments(query), strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-4)


def test_fitting_inducing_inputs_lowers_their_objective():
    x, y = line(60)
    model = gp.GaussianProcess(x, y, gp.initial_hyper(x, y))
    start = gp.initial_inducing(x, 8, [100, 101])
    assert start.shape == (2, 8, 3)
    better, found = gp.fit_inducing(model, start, 15)
    before, after = (gp.inducing_negative_log_likelihood(z, model)[0] for z in (start, better))
    assert (after < before - 0.1).all()
    torch.testing.assert_close(after, found.value)


def test_a_singular_covariance_is_repaired_and_counted():
    x, y = line(10)
    x[0, 1] = x[0, 0]  # the same input twice and next to no noise: only the first replica is singular
    hyper = gp.initial_hyper(x, y)
    hyper[..., -1] = -20
    hyper[..., :3] += 1
    posterior, repaired = gp.GaussianProcess(x, y, hyper).posterior()
    assert repaired[0] > 0
    assert posterior.weights.isfinite().all()


def test_hopeless_covariances_and_missing_data_are_named():
    with pytest.raises(ValueError, match="positive definite"):
        gp.robust_cholesky(torch.tensor([[[1.0, 2.0], [2.0, 1.0]]], dtype=torch.float64))
    with pytest.raises(ValueError, match="at least one transition"):
        gp.GaussianProcess(torch.zeros(1, 0, 3), torch.zeros(1, 2, 0), torch.zeros(1, 2, 5))
    x, y = line(5)
    with pytest.raises(ValueError, match="in float64, got"):
        gp.GaussianProcess(x.float(), y.float(), gp.initial_hyper(x, y))
    y[1, 1, 2] = math.nan
    with pytest.raises(ValueError, match=r"NaN or infinity in the target columns \[1\]"):
        gp.initial_hyper(x, y)
    with pytest.raises(ValueError, match=r"got shapes \(1, 4, 3\), \(1, 2, 5\)"):
        gp.GaussianProcess(torch.zeros(1, 4, 3), torch.zeros(1, 2, 5), torch.zeros(1, 2, 5))


def test_likelihood_of_an_impossible_covariance_is_nan_for_that_problem_alone():
    x, y = line(6)
    hyper = gp.initial_hyper(x, y)[:, 0]
    hyper[0, -2] = math.inf
    value, _ = gp.negative_log_likelihood(hyper, x, y[:, 0])
    assert value[0].isnan()
    assert value[1].isfinite()
