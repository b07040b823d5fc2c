"""What doubt is worth: learners that plan with and without it, paired seed by seed (statements DE2 and DE7).

Deep PILCO as `OURS`, its first trials beside networks whose doubt is left out at planning or never there, and beside
ensembles; as the thesis says it, on draws and on the mean network; and PILCO with its variance and without.
`deep-pilco-ours`, `deep-pilco-as-text` and `pilco-paper-15` are the learners with doubt that the others pair up with.
"""

from dataclasses import replace
from functools import partial

from dropout_uncertainty.data_efficiency.deep_pilco import learner
from dropout_uncertainty.data_efficiency.deep_pilco.learner import AS_TEXT, OURS, DeepPilcoConfig
from dropout_uncertainty.data_efficiency.learning import EXPERIMENT, GROUP
from dropout_uncertainty.data_efficiency.pilco import learner as pilco
from dropout_uncertainty.data_efficiency.pilco.learner import LONGER, PilcoConfig
from dropout_uncertainty.runs.sweep import Sweep

__all__ = ["CONFIGS", "FAMILY", "KEPT", "KEPT_PILCO", "TRIALS", "WITH_DOUBT"]

FAMILY = "doubt"
#: Controlled trials of the Deep PILCO learners: those within which the thesis's succeeds.
TRIALS = 25
#: Members of the ensembles.
MEMBERS = 5
#: The published learner with doubt that each config is compared with.
WITH_DOUBT = {
    "mean-network": "deep-pilco-ours",
    "no-dropout": "deep-pilco-ours",
    "ensemble": "deep-pilco-ours",
    "ensemble-mean": "doubt/ensemble",
    "as-text-mean": "deep-pilco-as-text",
    "pilco-mean": "pilco-paper-15",
}

BASE = replace(OURS, trials=TRIALS)
ENSEMBLE = replace(BASE, drop=0.0, ensemble=MEMBERS)
CONFIGS: dict[str, DeepPilcoConfig | PilcoConfig] = {
    "doubt/mean-network": replace(BASE, doubt=False),
    "doubt/no-dropout": replace(BASE, drop=0.0),
    "doubt/ensemble": ENSEMBLE,
    "doubt/ensemble-mean": replace(ENSEMBLE, doubt=False),
    "doubt/as-text-mean": replace(AS_TEXT, trials=TRIALS, doubt=False),
    "doubt/pilco-mean": replace(LONGER["pilco-paper-15"], doubt=False),
}


#: The arrays of the small records: costs, and predicted and true states.
KEPT = ("costs", "predicted_cost", "states", "predicted_mean", "predicted_std")
KEPT_PILCO = (*KEPT[:-1], "predicted_variance")
SWEEPS = [
    Sweep(EXPERIMENT, {n: c for n, c in CONFIGS.items() if isinstance(c, kind)}, start, precisions, GROUP, 40, memory)
    for kind, start, precisions, memory in (
        (DeepPilcoConfig, partial(learner.start, kept=KEPT), ("float32", "float64"), learner.memory),
        (PilcoConfig, partial(pilco.start, kept=KEPT_PILCO), ("float64",), pilco.memory),
    )
]
