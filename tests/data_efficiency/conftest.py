"""The golden vectors of the original PILCO code as float64 tensors, how they are compared, and a coarse plant."""

import gzip
import json
from pathlib import Path

import pytest
import torch

from dropout_uncertainty.data_efficiency.plant import cartpole

GOLDEN = Path(__file__).parents[1] / "golden" / "pilco_golden.json.gz"


@pytest.fixture(scope="session")
def golden():
    """Return cases(name): a list of dicts of float64 tensors, vectors flattened."""
    data = json.loads(gzip.decompress(GOLDEN.read_bytes()))

    def cases(name):
        return [{key: _tensor(value) for key, value in case.items()} for case in data[name]]

    return cases


def _tensor(value):
    if isinstance(value, str):
        return value
    return torch.tensor(value, dtype=torch.float64)


class Derivatives:
    """Jacobians in the layout of the golden data: matrices column by column, symmetric inputs symmetrised."""

    @staticmethod
    def flat(x):
        """Column-major vec of the trailing one or two axes."""
        return x.mT.reshape(-1) if x.ndim == 2 else x.reshape(-1)

    @classmethod
    def jacobian(cls, function, x):
        """Return d vec(function(x)) / d vec(x)."""
        jac = torch.autograd.functional.jacobian(lambda x: cls.flat(function(x)), x)
        return jac.mT.reshape(len(jac), -1) if x.ndim == 2 else jac

    @staticmethod
    def symmetrise(jac, size):
        """Average d . / d s[c, d] and d . / d s[d, c]."""
        jac = jac.reshape(-1, size, size)
        return ((jac + jac.mT) / 2).reshape(len(jac), -1)


@pytest.fixture(scope="session")
def derivatives():
    return Derivatives


@pytest.fixture(scope="session")
def close():
    """Return close(got, expected, tolerance): relative to the largest entry of the expected array."""

    def compare(got, expected, tolerance=1e-9, name=""):
        got, expected = got.detach().reshape(-1), expected.reshape(-1)
        scale = max(expected.abs().max().item(), 1e-5)  # below, both are differences of numbers near 1
        error = (got - expected).abs().max().item() / scale
        assert error <= tolerance, f"{name}: relative error {error:.1e} above {tolerance:.0e}"

    return compare


@pytest.fixture(scope="session")
def check_moments(derivatives, close):
    """Return a check of mean, covariance, slope and their derivatives in m [D] and s [D, D] on a golden case."""

    def check(case, function, m, s, names=("M", "S", "V"), tolerance=1e-9, slack=1e-9):
        got = function(m, s)
        for i, name in enumerate(names):
            close(got[i], case[name], tolerance, name)
            close(derivatives.jacobian(lambda m, i=i: function(m, s)[i], m), case[f"d{name}dm"], slack, f"d{name}dm")
            for key in (f"d{name}ds", f"d{name}dv"):
                if key in case:
                    jac = derivatives.jacobian(lambda s, i=i: function(m, (s + s.mT) / 2)[i], s)
                    expected = derivatives.symmetrise(case[key], len(m))
                    close(derivatives.symmetrise(jac, len(m)), expected, slack, key)

    return check


@pytest.fixture(scope="module")
def coarse_plant():
    """Two integration steps per interval: for what does not depend on their number."""
    accurate = cartpole.step
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cartpole, "step", lambda plant, state, force: accurate(plant, state, force, 2))
        patch.setattr(cartpole, "check_interval", lambda plant: None)
        yield
