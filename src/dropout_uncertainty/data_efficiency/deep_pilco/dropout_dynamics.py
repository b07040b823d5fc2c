"""The dynamics model of Deep PILCO: dropout networks that predict by how much a step changes the state.

A draw of the weights, ω̂ ~ q(ω), is a set of masks, one row per particle (`bayes`). `DropoutDynamics.function`
turns it into the function that each particle follows: whoever keeps the function, keeps the draw. Replicas R first.
"""

import copy
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from dropout_uncertainty import rng
from dropout_uncertainty.bayes import MLP, Masks, draw_masks, weight_decay
from dropout_uncertainty.data_efficiency.deep_pilco.network_gradient import set_gradients
from dropout_uncertainty.data_efficiency.plant.cartpole import FEATURE_NAMES, STATE_NAMES, features

# The noise standard deviation is learned between these, in units of the targets' standard deviation.
LOG_NOISE_RANGE = (-5.0, 0.0)
LOG_NOISE_START = -2.0
# What inputs and targets are scaled by, [R, 1, columns] each.
SCALING = ("input_mean", "input_std", "target_mean", "target_std")
# Optimisation steps whose masks and minibatches are drawn at once: long enough to forget the overhead of a
# generator, short enough to stay in cache.
BLOCK = 10


@dataclass(frozen=True)
class DrawnFunction:
    """One function per particle: the networks of the R replicas under one weight draw per row.

    The draw and the scaling of inputs and outputs are folded into the parameters: a dropped unit has the bias -inf,
    so that its activation is 0. Inputs and outputs are in SI units.
    """

    weights: tuple[Float[Tensor, "R _ _"], ...]
    biases: tuple[Float[Tensor, "R _ _"], ...]  # [R, K, out], or [R, 1, out] where rows do not differ
    input_mask: Float[Tensor, "R K D"] | None = None
    activation: str = "relu"
    angle_features: bool = True

    def __call__(self, inputs: Float[Tensor, "R K D"]) -> Float[Tensor, "R K E"]:
        """Return the change of state for features (without ``angle_features``: the state) and force."""
        x = inputs if self.input_mask is None else inputs * self.input_mask
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = torch.baddbmm(bias, x, weight)
            if layer < last:
                x = x.relu_() if self.activation == "relu" else x.sigmoid_()
        return x


class Networks:
    """R networks with Gaussian noise of learned size, and all that a fit changes of them.

    A kind of networks has a ``net`` whose parameters carry the replica axis first, ``log_noise`` [R, 1, E] in units of
    the targets' standard deviation, and what inputs and targets are scaled by (`SCALING`).
    """

    seeds: tuple[int, ...]
    net: nn.Module
    log_noise: nn.Parameter
    input_mean: Tensor
    input_std: Tensor
    target_mean: Tensor
    target_std: Tensor

    def _new_net(self, seeds: Sequence[int]) -> Any:
        """Return networks of this kind before any fit, in the precision of ``log_noise`` and on its device."""
        raise NotImplementedError

    def noise_std(self) -> Float[Tensor, "R E"]:
        """Return the learned standard deviation of the noise on each target, in SI units."""
        return (self._log_noise().exp() * self.target_std)[:, 0].detach()

    def _log_noise(self) -> Tensor:
        return self.log_noise.clamp(*LOG_NOISE_RANGE)

    def select(self, replicas: Sequence[int]) -> Any:
        """Return a copy with some of the replicas, or itself for all of them."""
        rows = list(replicas)
        if rows == list(range(len(self.seeds))):
            return self
        part = copy.copy(self)
        part.seeds = tuple(self.seeds[row] for row in rows)
        part.net, part.log_noise = self._new_net(part.seeds), nn.Parameter(self.log_noise.detach()[rows])
        part.restore({name: value[rows] for name, value in self.state().items()})
        return part

    def _restart_broken(self) -> Int[Tensor, " R"]:
        """Give replicas with a parameter that is not finite their first parameters; return which, as numbers."""
        parameters = [*self.net.parameters(), self.log_noise]
        lost = ~torch.stack([p.detach().flatten(1).isfinite().all(1) for p in parameters]).all(0)
        if lost.any():
            first = [*self._new_net(self.seeds).parameters(), torch.full_like(self.log_noise, LOG_NOISE_START)]
            with torch.no_grad():
                for mine, new in zip(parameters, first, strict=True):
                    mine[lost] = new[lost]
        return lost.long()

    def state(self) -> dict[str, Tensor]:
        """Return a copy of all that a fit changes."""
        named = {name: p.detach().clone() for name, p in self.net.named_parameters()}
        scaling = {name: getattr(self, name).clone() for name in SCALING}
        return {**named, "log_noise": self.log_noise.detach().clone(), **scaling}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from `state()` of networks made with the same arguments."""
        with torch.no_grad():
            for name, p in itertools.chain(self.net.named_parameters(), [("log_noise", self.log_noise)]):
                p.copy_(state[name])
        for name in SCALING:
            setattr(self, name, state[name].to(self.log_noise))


class DropoutDynamics(Networks):
    """R dropout networks from a state and a force to the change of the state, with Gaussian noise of learned size.

    Args:
        seeds: one per replica.
        hidden: widths of the hidden layers.
        drop: drop probability before every weight layer but the first.
        input_drop: drop probability of the inputs.
        activation: "relu" or "sigmoid".
        angle_features: give the network sin θ and cos θ in place of θ.
        standardise: scale inputs and targets to mean 0 and standard deviation 1 over the data of each fit.
        ends: numbers of inputs and outputs, if they are not those of the cart-pole.
        dtype: of the networks.
        device: of the networks.

    Raises:
        ValueError: for another activation, or a drop probability outside [0, 1).
    """

    def __init__(
        self,
        seeds: Sequence[int],
        *,
        hidden: Sequence[int] = (200, 200),
        drop: float = 0.05,
        input_drop: float = 0.0,
        activation: str = "relu",
        angle_features: bool = True,
        standardise: bool = True,
        ends: tuple[int, int] | None = None,
        dtype: torch.dtype = torch.float32,
        device: str = "cpu",
    ) -> None:
        if activation not in ("relu", "sigmoid"):
            raise ValueError(
                f"expected the activation relu or sigmoid, which is 0 for a dropped unit, got {activation}"
            )
        self.angle_features, self.standardise, self.activation = angle_features, standardise, activation
        width, outputs = ends or (len(FEATURE_NAMES if angle_features else STATE_NAMES) + 1, len(STATE_NAMES))
        self.sizes = (width, *hidden, outputs)
        self.drop = (input_drop, *(drop for _ in hidden))
        self.seeds = tuple(seeds)
        blank = torch.zeros(len(self.seeds), 1, 1, dtype=dtype, device=device)
        self.log_noise = nn.Parameter(blank.expand(-1, 1, outputs) + LOG_NOISE_START)
        self.net: MLP = self._new_net(self.seeds)
        self.input_mean, self.input_std = blank.expand(-1, 1, width), blank.expand(-1, 1, width) + 1
        self.target_mean, self.target_std = blank.expand(-1, 1, outputs), blank.expand(-1, 1, outputs) + 1

    def _new_net(self, seeds: Sequence[int]) -> MLP:
        """Return networks of this kind before any fit, in the precision of ``log_noise`` and on its device."""
        net = MLP(self.sizes, self.drop, seeds, activation=self.activation, dtype=self.log_noise.dtype)
        return net.to(self.log_noise.device)

    def inputs(self, states: Float[Tensor, "*batch 4"], forces: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch D"]:
        """Return what the network is given for states and forces [N]."""
        seen = features(states) if self.angle_features else states
        return torch.cat((seen, forces[..., None]), -1)

    def draw(self, count: int, *path: str | int) -> Masks:
        """Return ``count`` weight draws per replica, a function of each replica's seed and the path."""
        return draw_masks(self.seeds, self.sizes[:-1], self.drop, count, *path, weight=self.log_noise)

    def function(self, masks: Masks | None) -> DrawnFunction:
        """Return the functions of one weight draw per row; ``masks=None``: the deterministic pass."""
        weights = [weight.detach() for weight in self.net.weights]
        biases = [bias.detach() for bias in self.net.biases]
        masks = masks or (None,) * len(weights)
        centre = self.input_mean / self.input_std
        biases[0] = biases[0] - (centre if masks[0] is None else centre * masks[0]) @ weights[0]
        weights[0] = weights[0] / self.input_std.mT
        for layer, mask in enumerate(masks[1:], 1):
            if mask is not None:
                limit = (mask - 0.5) * torch.inf  # masks are 0 or above 1
                biases[layer - 1] = torch.minimum(biases[layer - 1], limit)
                weights[layer] = weights[layer] / (1 - self.drop[layer])
        weights[-1] = weights[-1] * self.target_std
        biases[-1] = biases[-1] * self.target_std + self.target_mean
        return DrawnFunction(tuple(weights), tuple(biases), masks[0], self.activation, self.angle_features)

    def mean(self) -> "DropoutDynamics":
        """Return the mean networks (weight scaling) in the place of their draws; parameters and scaling are shared."""
        sure = copy.copy(self)
        sure.drop = (0.0,) * len(self.drop)
        return sure

    def fit(
        self,
        inputs: Float[Tensor, "R N D"],
        targets: Float[Tensor, "R N E"],
        *path: str | int,
        steps: int,
        rate: float,
        final_rate: float,
        batch: int,
        length_scale: float,
    ) -> tuple[Float[Tensor, " R"], Int[Tensor, " R"]]:
        """Train on all transitions from where the networks are, with a new Adam.

        The objective is the mean negative log-likelihood under one weight draw per row plus, for each weight matrix,
        (1 - p) l² / (2 N) times its sum of squares: the Kullback-Leibler term of the variational bound over N. In the
        units of the log-likelihood the noise precision τ of thesis equation 3.14 cancels, so it may be learned.

        Args:
            inputs: from `inputs`.
            targets: state differences.
            path: names the random stream of this fit.
            steps: Adam steps.
            rate: their size at first; it falls along a cosine.
            final_rate: their size at the end, as a share of ``rate``.
            batch: transitions per step, drawn with replacement; at most N.
            length_scale: l of the prior over the weights.

        Returns:
            The objective [nats per transition, standardised targets], its likelihood averaged over the last tenth of
            the steps; and how often the likelihood was not finite and its gradient left out. A gradient that is not
            finite where the likelihood is breaks the network, which then begins anew at the next fit.

        Raises:
            ValueError: if inputs and targets do not have one row per transition each, or hold NaN or infinity.
        """
        if steps < 1 or batch < 1:
            raise ValueError(f"expected a step or more of a transition or more, got {steps} and {batch}")
        self._check(inputs, targets)
        repairs = self._restart_broken()
        x, y = self._scale(inputs, targets)
        count, batch = x.shape[1], min(batch, x.shape[1])
        decays = [weight_decay(count, p, length_scale, 1.0) for p in self.drop]
        parameters = [*self.net.parameters(), self.log_noise]
        adam = torch.optim.Adam(parameters, lr=rate, fused=True)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps, eta_min=rate * final_rate)
        late = torch.zeros_like(x[:, 0, 0])
        tail = max(1, steps // 10)
        for step in range(steps):
            block, place = divmod(step, BLOCK)
            if place == 0:
                rows, masks = self._draw_block(count, batch, *path, block)
            chosen = rows[:, place, :, None]
            part = slice(place * batch, (place + 1) * batch)
            loss = set_gradients(
                self.net, self.activation, self.log_noise, LOG_NOISE_RANGE,
                x.gather(1, chosen.expand(-1, -1, x.shape[-1])), y.gather(1, chosen.expand(-1, -1, y.shape[-1])),
                tuple(m if m is None else m[:, part] for m in masks), decays,
            )  # fmt: skip
            repairs += without_gradient(~loss.isfinite(), parameters)
            adam.step()
            schedule.step()
            if step >= steps - tail:
                late += loss / tail
        return late + self._penalty(decays), repairs

    def _check(self, inputs: Tensor, targets: Tensor) -> None:
        for data in (inputs, targets):
            if not isinstance(data, Tensor):
                raise ValueError(f"expected tensors of transitions, got {type(data).__name__}: use torch.as_tensor")
        runs, width, outputs = len(self.seeds), self.sizes[0], self.sizes[-1]
        shapes = tuple(inputs.shape), tuple(targets.shape)
        expected = (runs, inputs.shape[1], width), (runs, inputs.shape[1], outputs)
        if shapes != expected:
            raise ValueError(f"expected inputs [{runs}, N, {width}] and targets [{runs}, N, {outputs}], got {shapes}")
        check_finite(inputs, targets)

    def _scale(self, inputs: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
        """Set the scaling from the data and return them scaled."""
        inputs, targets = inputs.to(self.log_noise), targets.to(self.log_noise)
        if self.standardise:
            self.input_mean, self.input_std = scaling(inputs)
            self.target_mean, self.target_std = scaling(targets)
        return (inputs - self.input_mean) / self.input_std, (targets - self.target_mean) / self.target_std

    def _draw_block(self, count: int, batch: int, *path: str | int) -> tuple[Tensor, Masks]:
        device = self.log_noise.device
        rows = rng.stacked(
            lambda g: torch.randint(count, (BLOCK, batch), generator=g, device=device),
            self.seeds, "batches", *path, device=device,
        )  # fmt: skip
        return rows, self.draw(BLOCK * batch, *path)

    def _penalty(self, decays: Sequence[float]) -> Tensor:
        return sum(d * w.detach().square().sum((1, 2)) for d, w in zip(decays, self.net.weights, strict=True))


def check_finite(*data: Tensor) -> None:
    """Raise ValueError if data are not finite."""
    if not all(part.isfinite().all() for part in data):
        raise ValueError("expected finite transitions, got NaN or infinity; look at the trials they come from")


def without_gradient(bad: Bool[Tensor, " R"], parameters: Iterable[Tensor]) -> Bool[Tensor, " R"]:
    """Set the gradients of some replicas to 0, and return which."""
    if bad.any():
        for parameter in parameters:
            if parameter.grad is not None:
                parameter.grad[bad] = 0.0
    return bad


def scaling(data: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and standard deviation over the rows; 1 for a column that does not vary."""
    std = data.std(1, keepdim=True, correction=0)
    return data.mean(1, keepdim=True), torch.where(std > 1e-6, std, torch.ones_like(std))
