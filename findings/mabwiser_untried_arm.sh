#!/usr/bin/env bash
# mabwiser 2.7.4: the variance of an arm that was never tried is multiplied by the regularisation, not divided by it.
#
# Guess: Thompson sampling (`LinTS`) draws the coefficients of each arm from a normal distribution with the documented
#   covariance, alpha squared times the inverse of the Gram matrix plus lambda times the identity. For an arm without data
#   that is alpha squared over lambda, so its scores have a standard deviation of lambda to the power of -1/2, and a record
#   whose features are all zero changes nothing. With a weak prior, lambda = 0.01, a new arm is tried at once.
# Seen: until its first record an arm has the matrix itself where the inverse should be. With lambda = 0.01 the standard
#   deviation is 0.1 instead of 10, and the first real record raises it to 1: data adds doubt. A new arm that pays twice as
#   much as the known one is tried in none of 200 rounds, with each of 10 seeds; after a record of zeros it is taken
#   almost always. With lambda = 100 it is 10 instead of 0.1. `LinUCB` adds the same wrong numbers. At the default of 1
#   a matrix and its inverse are the same, and nothing shows.
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

HERE, NOWHERE = [[0.6, 0.8]], [[0.0, 0.0]]  # a context of length one, and one that says nothing about any arm


def bandit(policy, penalty, seed=0):
    """Return a bandit with 50 records of 1 for the arm "old", and an arm "new" without any."""
    told = MAB(["old"], policy(alpha=1.0, l2_lambda=penalty), seed=seed)
    told.fit(["old"] * 50, [1.0] * 50, HERE * 50)
    told.add_arm("new")
    return told


def spread(told):
    return np.std([score["new"] for score in told.predict_expectations(HERE * 20_000)])


def tries(told, rounds=200):
    """Return how often "new", which pays 2, is taken instead of "old", which pays 1."""
    count = 0
    for _ in range(rounds):
        arm = told.predict(HERE)
        count += arm == "new"
        told.partial_fit([arm], [2.0 if arm == "new" else 1.0], HERE)
    return count


def near(seen, value):
    return abs(seen / value - 1) < 0.03


as_seen = []
for penalty in (0.01, 0.1, 1.0, 10.0, 100.0):
    told = bandit(LearningPolicy.LinTS, penalty)
    untried = spread(told)
    told.partial_fit(["new"], [0.0], HERE)
    once = spread(told)
    told = bandit(LearningPolicy.LinTS, penalty)
    told.partial_fit(["new"], [0.0], NOWHERE)
    empty = spread(told)
    bonus = bandit(LearningPolicy.LinUCB, penalty).predict_expectations(HERE)["new"]
    print(f"lambda {penalty:6}: documented {penalty**-0.5:6.3f}, untried {untried:6.3f} (LinUCB adds {bonus:6.3f})", end="")
    print(f", after a record of zeros {empty:6.3f}, tried once {once:6.3f}")
    as_seen.append(near(untried, penalty**0.5) and near(bonus, penalty**0.5) and near(empty, penalty**-0.5))
    as_seen[-1] &= near(once, (penalty + 1) ** -0.5)
seeds = range(10)
never = [tries(bandit(LearningPolicy.LinTS, 0.01, seed)) for seed in seeds]
soon = []
for seed in seeds:
    told = bandit(LearningPolicy.LinTS, 0.01, seed)
    told.partial_fit(["new"], [0.0], NOWHERE)
    soon.append(tries(told))
print(f"lambda 0.01, 200 rounds, {len(seeds)} seeds: the better arm is tried {min(never)} to {max(never)} times,", end=" ")
print(f"after a record of zeros {min(soon)} to {max(soon)} times")
raise SystemExit(0 if all(as_seen) and max(never) == 0 and min(soon) > 150 else 1)
END
