#!/usr/bin/env bash
# mabwiser 2.7.4: in Thompson sampling all arms draw the same random numbers, so that chance hardly enters
# their comparison.
#
# Guess (written when a script for another fault had shown draws in common, not yet what they do to decisions):
#   `LinTS` at its defaults draws the coefficients of each arm from a normal distribution of the arm's own, as its
#   documentation says, independently, and takes the arm of the highest score: each arm as often as it is the best one
#   under the posterior. Of two arms with data at the same 20 contexts, the one that looks a little worse is taken in a
#   quarter of 20,000 decisions.
# Seen: it is never taken. Arms that are told their records in one call of `fit` each get a copy of the generator in one
#   and the same state, and draw the same numbers from then on: their scores have the documented means and spreads, but
#   a correlation of 1. Arms with the same contexts are compared without any chance, others with too little of it; of three
#   arms, the first is the best with probability 0.15 and never taken. Told arm by arm, with decisions in between, the
#   same arms with the same records are taken as often as they should. No seed changes that.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile numpy==2.3.5 scipy==1.16.3 scikit-learn==1.7.2 \
  pandas==2.3.3 joblib==1.5.2
python3 -m pip --python "$folder/venv" install --quiet --no-compile --no-deps mabwiser==2.7.4
cd "$folder"
"$folder/venv/bin/python" -W ignore - <<'END'
import numpy as np
from mabwiser.mab import MAB, LearningPolicy

DECISIONS = 20_000
random = np.random.default_rng(0)
here = np.array([0.5, 0.5, 0.5])  # the context of all decisions
same = random.standard_normal((20, 3))
noise = random.standard_normal(20)


def data(counts):
    """Return contexts and rewards of the arms: the same for all, but for the number of records and a slope of their own."""
    slopes = {"a": 0.5, "b": 0.65, "c": 0.5}
    return {arm: (same[:count], same[:count].sum(1) * slopes[arm] + noise[:count]) for arm, count in counts.items()}


def posterior(records):
    """Return for each arm the documented mean and standard deviation of its score here."""
    parts = []
    for x, y in records.values():
        cov = np.linalg.inv(x.T @ x + np.eye(3))
        parts.append((here @ cov @ x.T @ y, (here @ cov @ here) ** 0.5))
    return np.array(parts).T


def at_once(records, seed):
    told = MAB(list(records), LearningPolicy.LinTS(), seed=seed)
    arms = [arm for arm, (x, _) in records.items() for _ in x]
    told.fit(arms, np.concatenate([y for _, y in records.values()]), np.concatenate([x for x, _ in records.values()]))
    return told


def one_by_one(records, seed):
    """Tell the same arms the same, but each in its own call, after a thousand decisions among the arms before."""
    first, *others = records
    told = at_once({first: records[first]}, seed)
    for arm in others:
        told.predict([here] * 1000)
        told.add_arm(arm)
        told.partial_fit([arm] * len(records[arm][0]), records[arm][1], records[arm][0])
    return told


def look(told, arms):
    """Return the shares of decisions for the arms, the means and spreads of their scores, and the correlation of two."""
    scores = told.predict_expectations([here] * DECISIONS)
    scores = np.array([[score[arm] for arm in arms] for score in scores])
    taken = told.predict([here] * DECISIONS)
    shares = [sum(arm == said for said in taken) / DECISIONS for arm in arms]
    return np.array(shares), scores.mean(0), scores.std(0), np.corrcoef(scores.T)[0, 1]


fine = True
for counts in ({"a": 20, "b": 20}, {"a": 20, "b": 20, "c": 6}):
    records = data(counts)
    mean, std = posterior(records)
    best = random.normal(mean, std, (400_000, len(mean))).argmax(1)
    due = np.bincount(best, minlength=len(mean)) / len(best)
    print(f"records {counts}: each arm is the best with probability {due.round(3)}")
    for tell in (at_once, one_by_one):
        for seed in (0, 1, 2):
            shares, means, stds, together = look(tell(records, seed), list(records))
            print(f"  told {tell.__name__}, seed {seed}: taken {shares.round(3)}, correlation of a and b {together:.3f}")
            fine &= np.abs(means - mean).max() < 0.02 and np.abs(stds / std - 1).max() < 0.03
            if tell is at_once:
                fine &= together > 0.999 and np.abs(shares - due).max() > 0.1 and shares[0] == 0 and due[0] > 0.1
            else:
                fine &= abs(together) < 0.03 and np.abs(shares - due).max() < 0.02
raise SystemExit(0 if fine else 1)
END
