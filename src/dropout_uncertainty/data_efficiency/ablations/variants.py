"""What matters in Deep PILCO: the learner `OURS` with one thing changed at a time (statements DE4 to DE7 and DE10).

Every variant is one line of the table `VARIANTS`; all other choices, and all random numbers, are those of `OURS`, so
that a variant and `OURS` pair up seed by seed. Beside them stand two measurements that change nothing: `mechanism`
looks into the learner `OURS` while it learns, `scaling` takes times on synthetic transitions.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from dropout_uncertainty.data_efficiency.ablations import scaling
from dropout_uncertainty.data_efficiency.ablations.probes import Mechanism, MechanismConfig
from dropout_uncertainty.data_efficiency.ablations.scaling import ScalingConfig
from dropout_uncertainty.data_efficiency.deep_pilco import learner
from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS, DeepPilcoConfig
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP
from dropout_uncertainty.runs.sweep import Sweep
from dropout_uncertainty.settings import widened

__all__ = ["CONFIGS", "FAMILY", "TRIALS", "VARIANTS", "Variant", "VariantConfig", "start"]

FAMILY = "what-matters"
#: Controlled trials of every variant: by then `OURS` has solved the task long ago on development seeds.
TRIALS = 20


@dataclass(frozen=True)
class VariantConfig(DeepPilcoConfig):
    """The learner of `deep_pilco.learner`; `doubt` is part of the published identity of these configs."""

    doubt: bool = True  #: The policy is improved on draws of the weights (`DeepPilcoConfig.doubt`).


#: `OURS` for fewer trials: what a variant differs from in its named fields alone.
BASE = widened(VariantConfig, OURS, trials=TRIALS)


@dataclass(frozen=True)
class Variant:
    """One change of `OURS`: the statements it serves, what it is in words, and the fields that change."""

    claim: str
    words: str
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def config(self) -> VariantConfig:
        """The config of the learner."""
        return replace(BASE, **self.changes)


FIXED = {"redraw_every": 0}
VARIANTS: dict[str, Variant] = {
    "matching-diagonal": Variant("DE4", "moments of each dimension alone", {"matching": "diagonal"}),
    "matching-off": Variant("DE4", "no moment matching", {"matching": "off"}),
    "particles-fixed": Variant("DE5", "fixed particles, Adam", FIXED),
    "particles-fixed-bfgs": Variant("DE5", "fixed particles, BFGS", FIXED | {"optimiser": "bfgs"}),
    "masks-redrawn": Variant("DE6", "masks redrawn at each step", {"hold_masks": False}),
    "masks-redrawn-matching-off": Variant("DE6", "… and no matching", {"hold_masks": False, "matching": "off"}),
    "no-dropout": Variant("DE7", "no dropout", {"drop": 0.0}),
    "mean-network": Variant("DE7", "trained with dropout, plans without", {"doubt": False}),
    "dropout-half": Variant("DE10", "dropout probability: half", {"drop": OURS.drop / 2}),
    "dropout-twice": Variant("DE10", "… twice", {"drop": 2 * OURS.drop}),
    "length-scale-half": Variant("DE10", "length-scale: half", {"length_scale": OURS.length_scale / 2}),
    "length-scale-twice": Variant("DE10", "… twice", {"length_scale": 2 * OURS.length_scale}),
    "model-rate-half": Variant("DE10", "network's learning rate: half", {"model_rate": OURS.model_rate / 2}),
    "model-rate-twice": Variant("DE10", "… twice", {"model_rate": 2 * OURS.model_rate}),
    "policy-rate-half": Variant("DE10", "policy's learning rate: half", {"policy_rate": OURS.policy_rate / 2}),
    "policy-rate-twice": Variant("DE10", "… twice", {"policy_rate": 2 * OURS.policy_rate}),
    "particles-third": Variant("DE10", "a third of the particles", {"particles": OURS.particles // 3}),
    "weights-fifth": Variant("DE10", "first weights of the policy: a fifth", {"weight_std": OURS.weight_std / 5}),
    "no-guard": Variant("DE10", "no redraw of the policy", {"guard": 1.0}),
    "cost-at-mean": Variant("DE10", "public ports: cost of the mean particle", {"cost_of": "mean"}),
    "euler-plant": Variant("DE10", "public ports: Euler plant", {"integration": "euler"}),
    "raw-inputs": Variant("DE10", "public ports: raw inputs", {"angle_features": False, "standardise": False}),
}

#: The measurements beside them.
MECHANISM = widened(MechanismConfig, OURS, trials=TRIALS)
SCALING = ScalingConfig()
#: What is kept of learning itself.
KEPT = ("costs", "predicted_cost")
start = partial(learner.start, kept=KEPT)
start_mechanism = partial(start, kind=Mechanism)
SWEEPS = [
    Sweep(EXPERIMENT, configs, begin, ("float32", "float64"), group, repetitions=10, memory=memory)
    for configs, begin, group, memory in (
        ({f"{FAMILY}/{name}": variant.config for name, variant in VARIANTS.items()}, start, GROUP, learner.memory),
        ({f"{FAMILY}/mechanism": MECHANISM}, start_mechanism, GROUP, learner.memory),
        ({f"{FAMILY}/scaling": SCALING}, scaling.start, {"cpu": GROUP["cpu"]}, scaling.memory),
    )
]
CONFIGS = {name: config for sweep in SWEEPS for name, config in sweep.configs.items()}
