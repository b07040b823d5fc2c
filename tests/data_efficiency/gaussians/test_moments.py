"""Moment matching: against the original's golden vectors, against Monte Carlo, and in its limits."""

import math

import pytest
import torch

from dropout_uncertainty.data_efficiency.gaussians import squared_exponential
from dropout_uncertainty.data_efficiency.gaussians.moments import Gaussian, feature_moments, sines
from dropout_uncertainty.data_efficiency.gaussians.squared_exponential import SquaredExponential
from dropout_uncertainty.data_efficiency.plant.cartpole import features
from dropout_uncertainty.data_efficiency.policies import squash, squash_moments
from dropout_uncertainty.rng import generator


def symmetric(s):
    return (s + s.mT) / 2


@pytest.mark.parametrize("number", range(5))
def test_sine_and_cosine_match_the_original(golden, check_moments, number):
    case = golden("gTrig")[number]
    index = case["i"].reshape(-1).long() - 1
    scale = case["e"].reshape(-1)
    k = len(index)

    def trig(m, s):
        # sin and cos of each angle side by side, as the original orders them
        pick = torch.zeros(len(m), 2 * k, dtype=m.dtype)
        for j, i in enumerate(index):
            pick[i, 2 * j] = pick[i, 2 * j + 1] = 1
        shift = torch.tensor([0, math.pi / 2] * k, dtype=m.dtype)
        amplitude = (torch.ones(k, dtype=m.dtype) * scale).repeat_interleave(2)
        mean, cov, derivative = sines(m @ pick + shift, pick.T @ s @ pick)
        return mean * amplitude, amplitude[:, None] * cov * amplitude, pick * derivative * amplitude

    check_moments(case, trig, case["m"][:, 0], case["v"], names=("M", "V", "C"))


@pytest.mark.parametrize("number", range(5))
def test_squash_matches_the_original(golden, check_moments, number):
    case = golden("gSat")[number]
    index = case["i"].reshape(-1).long() - 1
    scale = torch.ones(len(index), dtype=torch.float64) * case["e"].reshape(-1)
    pick = torch.eye(4, dtype=torch.float64)[:, index]

    def squashed(m, s):
        out = squash_moments(Gaussian(m @ pick, pick.T @ s @ pick), 1.0)
        return out.mean * scale, scale[:, None] * out.cov * scale, pick @ out.slope * scale

    check_moments(case, squashed, case["m"][:, 0], case["v"], names=("M", "V", "C"))


def some_functions(replicas=2, count=9, outputs=3, dim=4, seed=100, spread=0.5):
    g = generator(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    centres, log_scales = normal(replicas, count, dim), spread * normal(replicas, outputs, dim) + 0.5
    plain = SquaredExponential(centres, log_scales, 0.2 * normal(replicas, outputs), normal(replicas, outputs, count))
    gram = plain.kernel(centres) + 0.1 * torch.eye(count, dtype=torch.float64)
    posterior = SquaredExponential(centres, log_scales, plain.log_signal_std, plain.weights, torch.linalg.inv(gram))
    root = 0.4 * normal(replicas, dim, dim)
    return plain, posterior, Gaussian(normal(replicas, dim), root @ root.mT)


def within_standard_errors(samples, expected, limit=4.5):
    """Assert that the mean over the first axis of samples is `expected`, up to `limit` standard errors."""
    error = samples.std(0) / math.sqrt(len(samples))
    z = ((samples.mean(0) - expected).abs() / (error + 1e-12)).max()
    assert z < limit, f"{z:.1f} standard errors away"


def draws(x, count, seed=101):
    noise = torch.randn(count, *x.mean.shape, generator=generator(seed), dtype=torch.float64)
    return x.mean + (torch.linalg.cholesky(x.cov) @ noise[..., None])[..., 0]


@pytest.mark.parametrize("outputs", [1, 3])
def test_functions_match_monte_carlo(outputs):
    plain, posterior, x = some_functions(outputs=outputs)
    samples = draws(x, 40_000).transpose(0, 1)  # [R, K, D]
    values = plain(samples)
    centred = values - values.mean(1, keepdim=True)
    product = centred[..., :, None] * centred[..., None, :]
    cross = (samples - x.mean[:, None])[..., None] * centred[..., None, :]
    moments = plain.moments(x)
    within_standard_errors(values.transpose(0, 1), moments.mean)
    within_standard_errors(product.transpose(0, 1), moments.cov)
    within_standard_errors(cross.transpose(0, 1), x.cov @ moments.slope)
    own = torch.exp(2 * posterior.log_signal_std)[..., None]
    k = posterior.kernel(samples)
    variance = own - ((k @ posterior.precision) * k).sum(-1)  # [R, E, K]
    total = product + torch.diag_embed(variance.mT)
    within_standard_errors(total.transpose(0, 1), posterior.moments(x).cov)


def test_features_and_squash_match_monte_carlo():
    _, _, x = some_functions()
    samples = draws(x, 40_000)
    for function, moments in ((features, feature_moments(x)), (lambda u: squash(u, 10.0), squash_moments(x, 10.0))):
        values = function(samples)
        centred = values - values.mean(0)
        within_standard_errors(values, moments.mean)
        within_standard_errors(centred[..., :, None] * centred[..., None, :], moments.cov)
        within_standard_errors((samples - x.mean)[..., None] * centred[..., None, :], x.cov @ moments.slope)


def test_a_certain_input_gives_the_point_prediction():
    plain, posterior, x = some_functions()
    certain = Gaussian(x.mean, torch.zeros_like(x.cov))
    jac = torch.autograd.functional.jacobian(lambda m: plain(m[:, None])[:, 0].sum(0), x.mean)  # [E, R, D]
    for f in (plain, posterior):
        moments = f.moments(certain)
        torch.testing.assert_close(moments.mean, f(x.mean[:, None])[:, 0])
        torch.testing.assert_close(moments.slope, jac.permute(1, 2, 0))
    torch.testing.assert_close(
        plain.moments(certain).cov, torch.zeros(2, 3, 3, dtype=torch.float64), rtol=0, atol=1e-13
    )
    k = posterior.kernel(x.mean[:, None])[..., 0, :]
    variance = torch.exp(2 * posterior.log_signal_std) - ((k[..., None, :] @ posterior.precision)[..., 0, :] * k).sum(
        -1
    )
    torch.testing.assert_close(posterior.moments(certain).cov, torch.diag_embed(variance), rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(feature_moments(Gaussian(x.mean, certain.cov)).mean, features(x.mean))


def test_fused_second_moment_equals_the_plain_formula_and_has_its_gradient(monkeypatch):
    plain, posterior, x = some_functions(count=23)
    no_precision = SquaredExponential(
        *(getattr(plain, n) for n in ("centres", "log_length_scales", "log_signal_std", "weights")),
        precision=torch.zeros_like(posterior.precision),
    )
    fused, direct = no_precision.moments(x).cov, plain.moments(x).cov
    prior = torch.diag_embed(torch.exp(2 * plain.log_signal_std))
    torch.testing.assert_close(fused - prior, direct, rtol=1e-11, atol=1e-11)
    inputs = (x.mean.clone().requires_grad_(), x.cov.clone().requires_grad_())
    assert torch.autograd.gradcheck(lambda m, s: posterior.moments(Gaussian(m, symmetric(s))), inputs)
    values, sums = posterior.values(x)
    monkeypatch.setattr(squared_exponential, "BLOCK", {"cpu": 600})
    assert len(squared_exponential.blocks(6, 23**2, torch.device("cpu"))) == 6
    in_blocks, block_sums = posterior.values(x)
    for got, expected in zip((in_blocks, *block_sums), (values, *sums), strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-12, atol=1e-12)


def test_plain_moments_have_gradients_in_the_functions_own_parameters():
    f, _, x = some_functions(count=5, outputs=2, dim=3)
    parameters = tuple(
        p.clone().requires_grad_() for p in (f.centres, f.log_length_scales, f.log_signal_std, f.weights, *x)
    )

    def moments(centres, scales, signal, weights, m, s):
        return SquaredExponential(centres, scales, signal, weights).moments(Gaussian(m, symmetric(s)))

    assert torch.autograd.gradcheck(moments, parameters)


def test_a_replica_alone_equals_the_same_among_others():
    _, f, x = some_functions(replicas=3)
    together = f.moments(x)
    for r in range(3):
        own = (f.centres, f.log_length_scales, f.log_signal_std, f.weights, f.precision)
        alone = SquaredExponential(*(a[r : r + 1] for a in own)).moments(Gaussian(x.mean[r : r + 1], x.cov[r : r + 1]))
        for got, expected in zip(alone, together, strict=True):
            torch.testing.assert_close(got[0], expected[r], rtol=1e-12, atol=1e-13)


def test_shapes_that_disagree_are_named():
    f, _, _ = some_functions()
    with pytest.raises(ValueError, match=r"shapes \(\(2, 3, 4\), \(2, 3\), \(2, 3, 9\)\)"):
        SquaredExponential(f.centres, f.log_length_scales[..., :2], f.log_signal_std, f.weights)
