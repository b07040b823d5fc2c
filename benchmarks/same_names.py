"""What libraries compute under the names of the thesis's acquisition functions, on six points.

``python benchmarks/same_names.py [--write]`` asks every library that is installed, compares what it returns with a few
formulas, and prints which of them it is; ``--write`` keeps the table in ``records/same_names.csv``, from which the book
shows it. A library that cannot be asked is one line with the reason.
"""

import argparse
import csv
import importlib.metadata
import warnings
from pathlib import Path

import numpy as np
from scipy.special import entr

TABLE = Path(__file__).resolve().parents[1] / "records" / "same_names.csv"
#: What four weight draws say of three classes.
POINTS = {
    "sure": [[0.98, 0.01, 0.01]] * 4,
    "sure draws that contradict each other": [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]],
    "every draw says uniform": [[1 / 3, 1 / 3, 1 / 3]] * 4,
    "one draw is outvoted": [[0.7, 0.2, 0.1], [0.6, 0.3, 0.1], [0.8, 0.1, 0.1], [0.2, 0.7, 0.1]],
    "three classes named": [[0.5, 0.3, 0.2], [0.3, 0.5, 0.2], [0.2, 0.2, 0.6], [0.5, 0.4, 0.1]],
    "nearly two classes": [[0.55, 0.45, 0], [0.5, 0.5, 0], [0.45, 0.55, 0], [0.6, 0.4, 0]],
}
PROBS = np.array(list(POINTS.values()), float).swapaxes(0, 1)  # [S draws, N points, C classes]


def votes_against(p):
    """Return the share of draws that do not vote for the most frequent class."""
    votes = np.eye(p.shape[-1])[p.argmax(-1)].mean(0)
    return 1 - votes.max(-1)


#: Formulas by what they are in words; p̄ is the mean over the draws.
FORMULAS = {
    "entropy of the mean prediction, H[p̄]": lambda p: entr(p.mean(0)).sum(-1),
    "mean entropy of the single draws, mean H[p]": lambda p: entr(p).sum(-1).mean(0),
    "mutual information, H[p̄] − mean H[p]": lambda p: entr(p.mean(0)).sum(-1) - entr(p).sum(-1).mean(0),
    "share of draws that are outvoted": votes_against,
    "least confidence, 1 − max p̄": lambda p: 1 - p.mean(0).max(-1),
    "mean standard deviation over draws": lambda p: p.std(0).mean(-1),
    "max p̄": lambda p: p.mean(0).max(-1),
    "gap between the two likeliest classes": lambda p: np.diff(np.sort(p.mean(0))[:, -2:])[:, 0],
    "1 minus that gap": lambda p: 1 - np.diff(np.sort(p.mean(0))[:, -2:])[:, 0],
}


def describe(scores):
    """Return the formula that gives these scores, or their multiple by 1 / log 2, where they are numbers."""
    if len(scores) != len(POINTS):
        return f"{len(scores)} values for {len(POINTS)} points"
    known = np.isfinite(scores)
    lost = "" if known.all() else "; not a number where a draw gives a class no probability"
    for name, formula in FORMULAS.items():
        for unit, factor in (("", 1.0), (", in bits", 1 / np.log(2))):
            if np.allclose(scores[known], factor * formula(PROBS)[known], atol=1e-4):
                nats = ", in nats" if not unit and "H[" in name else ""
                return name + unit + nats + lost
    for name, formula in FORMULAS.items():
        expected = formula(PROBS)[known]
        factor = scores[known] @ expected / (expected @ expected)
        if np.allclose(scores[known], factor * expected, atol=1e-4):
            return f"{name}, times {factor:.4g}{lost}"
    return "none of these formulas" + lost


def ours():
    import torch

    from dropout_uncertainty.active_learning.acquisition import ACQUISITIONS, score

    return {name: score(name, torch.tensor(PROBS).log()).numpy() for name in ACQUISITIONS}


def with_baal():
    from baal.active import heuristics

    p = PROBS.transpose(1, 2, 0)  # [N, C, S]
    return {name: getattr(heuristics, name)().compute_score(p) for name in ("BALD", "Entropy", "Certainty", "Margin")}


def with_batchbald_redux():
    import torch
    from batchbald_redux.batchbald import compute_entropy, get_bald_batch

    p = torch.tensor(PROBS).log().swapaxes(0, 1)  # [N, S, C]
    batch = get_bald_batch(p.clone(), len(POINTS), dtype=torch.float64)
    bald = np.zeros(len(POINTS))
    bald[batch.indices] = batch.scores
    return {"get_bald_batch": bald, "compute_entropy": compute_entropy(p).numpy()}


def with_scikit_activeml():
    from skactiveml.pool import uncertainty_scores
    from skactiveml.pool._bald import batch_bald
    from skactiveml.pool._query_by_committee import variation_ratios

    mean = PROBS.mean(0)
    return {
        "batch_bald (of one point)": batch_bald(PROBS.copy(), 1)[0],
        "variation_ratios": variation_ratios(PROBS.argmax(-1).T),
        **{f"uncertainty_scores: {m}": uncertainty_scores(mean, method=m) for m in ("entropy", "least_confident")},
    }


def with_small_text():
    from small_text.query_strategies.bayesian import _bald

    return {"BALD": _bald(PROBS.swapaxes(0, 1))}


def with_modal():
    from modAL import dropout

    p = list(PROBS)
    return {
        "mc_dropout_bald": dropout._bald_divergence(p),
        "mc_dropout_max_entropy": dropout._entropy(p),
        "mc_dropout_max_variationRatios": dropout._variation_ratios(p),
        "mc_dropout_mean_st": dropout._mean_standard_deviation(p),
    }


def with_torch_uncertainty():
    import torch
    from torch_uncertainty.metrics import classification

    p = torch.tensor(PROBS).swapaxes(0, 1)  # [B examples, N estimators, C] as documented

    def ask(name, probs=p, **options):
        metric = getattr(classification, name)(reduction="none", **options)
        metric.update(probs)
        return metric.compute().numpy()

    swapped = p.swapaxes(0, 1)
    return {
        "MutualInformation": ask("MutualInformation"),
        "Entropy": ask("Entropy"),
        "VariationRatio, as documented": ask("VariationRatio", probabilistic=False),
        "VariationRatio, axes swapped": ask("VariationRatio", swapped, probabilistic=False),
        "VariationRatio, axes swapped, default": ask("VariationRatio", swapped),
    }


#: Name of the distribution -> what asks it.
LIBRARIES = {
    "dropout-uncertainty": ours,
    "baal": with_baal,
    "batchbald_redux": with_batchbald_redux,
    "scikit-activeml": with_scikit_activeml,
    "small-text": with_small_text,
    "modAL-python": with_modal,
    "torch-uncertainty": with_torch_uncertainty,
}


def numbers(scores):
    """Return one cell per point, empty where a library does not give one score per point."""
    return [f"{value + 0.0:.4f}" for value in scores] if len(scores) == len(POINTS) else [""] * len(POINTS)


def asked(library):
    """Return one line of the table per score of a library, or one that says why it cannot be asked."""
    try:
        version = importlib.metadata.version(library)
        scores = LIBRARIES[library]()
    except Exception as error:  # whatever a library does on import is a line of the table
        reason = f"cannot be asked: {type(error).__name__}: {error}".splitlines()[0]
        return [[library, "", "", reason, *[""] * len(POINTS)]]
    return [[library, version, name, describe(values), *numbers(values)] for name, values in scores.items()]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.relative_to(TABLE.parents[1])}")
    write = parser.parse_args().write
    warnings.simplefilter("ignore")
    rows = [["library", "version", "name", "computes", *POINTS], *(row for name in LIBRARIES for row in asked(name))]
    for row in rows:
        print("  ".join(row))
    if write:
        with open(TABLE, "w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
