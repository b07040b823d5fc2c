#!/usr/bin/env bash
# scikit-activeml 1.0.1: asking for a score changes the probabilities that were asked about.
#
# Guess: `batch_bald` and `average_kl_divergence` copy their argument before they clip it, so the
#   caller's array stays as it was.
# Seen: both write into it. `batch_bald` raises zeros to 1e-7 without renormalising, so the rows then
#   sum to more than one; `average_kl_divergence` also divides by the sum. What is computed from the
#   same array afterwards (its log-likelihood, say) is another number than before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile scikit-activeml==1.0.1 numpy==2.3.5 scipy==1.16.3 scikit-learn==1.7.2
cd "$folder"
"$folder/venv/bin/python" -W ignore - <<'END'
import numpy
from skactiveml.pool import average_kl_divergence, batch_bald

# estimators, points, classes
original = numpy.array([[[1.0, 0.0], [0.5, 0.5]], [[0.0, 1.0], [0.5, 0.5]]])


def changed_by(score):
    probabilities = original.copy()
    score(probabilities)
    return int((probabilities != original).sum()), probabilities.min(), probabilities.sum(2).max() - 1


scores = {
    "batch_bald": lambda p: batch_bald(p, batch_size=1, random_state=0),
    "average_kl_divergence": average_kl_divergence,
}
seen = {name: changed_by(score) for name, score in scores.items()}
for name, (count, least, excess) in seen.items():
    print(f"{name}: {count} of 8 entries changed, least now {least:.1e}, sum above one by {excess:.1e}")
raise SystemExit(0 if all(count > 0 and least > 0 for count, least, _ in seen.values()) else 1)
END
