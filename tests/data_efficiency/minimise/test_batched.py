"""Minimisation in lockstep: every problem takes the path it takes alone, and reports what went wrong."""

import pytest
import torch
from scipy import optimize

from dropout_uncertainty.data_efficiency.minimise import batched, bfgs


def rosenbrock(x):
    return (100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2).sum(1)


def with_gradient(function):
    def objective(x, numbers):
        x = x.detach().requires_grad_()
        value = function(x)
        return value.detach(), torch.autograd.grad(value.sum(), x)[0]

    return objective


STARTS = torch.tensor([[-1.2, 1.0, 0.3], [0.0, 0.0, 0.0], [2.0, -1.0, 1.5]], dtype=torch.float64)


def scalar(x):
    value, gradient = with_gradient(rosenbrock)(torch.from_numpy(x)[None], [0])
    return value.item(), gradient[0].numpy()


def test_small_problems_take_the_path_of_bfgs():
    together = batched.minimise(with_gradient(rosenbrock), STARTS, 30)
    for i, start in enumerate(STARTS):
        alone = bfgs.minimise(scalar, start.numpy(), 30)
        torch.testing.assert_close(together.x[i], torch.from_numpy(alone.x), rtol=1e-12, atol=1e-12)
        assert together.iterations[i] == alone.searches


def test_large_problems_take_scipys_path(monkeypatch):
    monkeypatch.setattr(batched, "DENSE_UP_TO", 0)
    together = batched.minimise(with_gradient(rosenbrock), STARTS, 30)
    for i, start in enumerate(STARTS):
        options = {**batched.LIMITED, "maxiter": 30}
        alone = optimize.minimize(scalar, start.numpy(), jac=True, method="L-BFGS-B", options=options)
        torch.testing.assert_close(together.x[i], torch.from_numpy(alone.x), rtol=1e-12, atol=1e-12)
        assert together.iterations[i] == alone.nit
        assert together.evaluations[i] == alone.nfev


def test_reaches_the_minimum_and_leaves_the_start_alone():
    start = STARTS.clone()
    found = batched.minimise(with_gradient(rosenbrock), start, 200)
    torch.testing.assert_close(found.x, torch.ones_like(STARTS), rtol=0, atol=1e-4)
    assert torch.equal(start, STARTS)
    assert (found.repairs == 0).all()


def test_finished_problems_leave_the_batch():
    sizes = []

    def objective(x, numbers):
        sizes.append(list(numbers))
        return with_gradient(rosenbrock)(x, numbers)

    at_minimum = torch.ones(1, 3, dtype=torch.float64)
    batched.minimise(objective, torch.cat((at_minimum, STARTS[:1])), 20)
    assert sizes[0] == [0, 1]
    assert sizes[-1] == [1]


@pytest.mark.parametrize("dense", [500, 0])
def test_values_that_are_not_finite_turn_the_line_search_back(monkeypatch, dense):
    monkeypatch.setattr(batched, "DENSE_UP_TO", dense)

    def walled(x):
        value = ((x - 1) ** 2).sum(1)
        return torch.where(x[:, 0] > 1.5, torch.nan, value)

    found = batched.minimise(with_gradient(walled), torch.tensor([[-30.0], [0.9]], dtype=torch.float64), 50)
    torch.testing.assert_close(found.x, torch.ones(2, 1, dtype=torch.float64), rtol=0, atol=1e-3)


def test_a_start_without_value_is_reported():
    def broken(x):
        return (x**2).sum(1) * torch.tensor([torch.nan, 1.0], dtype=torch.float64)[: len(x)]

    found = batched.minimise(with_gradient(broken), torch.ones(2, 2, dtype=torch.float64), 5)
    assert found.value[0].isnan()
    assert found.repairs[0] >= 1
    torch.testing.assert_close(found.x[0], torch.ones(2, dtype=torch.float64))


@pytest.mark.parametrize("dense", [500, 0])
def test_a_failed_line_search_is_counted(monkeypatch, dense):
    monkeypatch.setattr(batched, "DENSE_UP_TO", dense)
    calls = []

    def lying(x, numbers):
        calls.append(len(calls))
        return torch.tensor([float(len(calls))], dtype=torch.float64), x  # every value is higher than the last

    found = batched.minimise(lying, torch.ones(1, 2, dtype=torch.float64), 10)
    assert found.failures[0] >= 1
    assert found.value[0] == 1
    torch.testing.assert_close(found.x, torch.ones(1, 2, dtype=torch.float64))


def test_an_error_in_the_function_reaches_the_caller():
    def failing(x, numbers):
        raise ArithmeticError("no")

    with pytest.raises(ArithmeticError, match="no"):
        batched.minimise(failing, STARTS, 5)
