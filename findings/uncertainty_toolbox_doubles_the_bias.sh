#!/usr/bin/env bash
# uncertainty-toolbox 0.1.1: recalibrating the quantiles of a biased forecast doubles the bias.
#
# Guess: for 20,000 forecasts N(1, 1) of labels that are N(0, 1), the quantiles of `get_quantile_recalibrator` lie above
#   the share of new labels that they name, to within 0.02, and `get_proportion_under_quantile` returns the share of labels
#   under a quantile of `get_quantile`.
# Seen: the share of labels under a quantile is counted from forecast minus label, where label minus forecast is meant, so
#   it is the share above the mirrored quantile: 16 % under the median are said, 84 % there are. What is fitted to that
#   moves the wrong way: under the recalibrated median lie 98 % of the new labels, under the quantile of 10 % 77 %, as if
#   the bias were two. The calibration error of the same library has the same sign and reports 0.26 before and less than
#   0.01 after, while the quantiles went from 0.26 to 0.43 off. Errors symmetric about zero are corrected as they should be.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile numpy==2.3.5 scipy==1.16.3 scikit-learn==1.7.2 \
  matplotlib==3.10.7 tqdm==4.67.1 uncertainty-toolbox==0.1.1
cd "$folder"
"$folder/venv/bin/python" -W ignore - <<'END'
import numpy as np
import uncertainty_toolbox as uct
from scipy.stats import norm
from uncertainty_toolbox.metrics_calibration import get_proportion_under_quantile, get_quantile
from uncertainty_toolbox.recalibration import get_quantile_recalibrator, iso_recal

LEVELS, COUNT = np.array([0.1, 0.25, 0.5, 0.75, 0.9]), 20_000
old, new = np.random.default_rng(0).standard_normal((2, COUNT))
one = np.ones(COUNT)


def shares(mean, std, recalibrated):
    """Return the shares of the new labels under the quantiles of the forecast N(mean, std), recalibrated or not."""
    if recalibrated:
        quantile = get_quantile_recalibrator(mean * one, std * one, old)
    else:
        quantile = get_quantile
    return np.array([(new <= quantile(mean * one, std * one, level)).mean() for level in LEVELS])


def show(name, values):
    print(f"{name:53}", *(f"{value:6.3f}" for value in values))


def model(mean, labels):
    return iso_recal(*uct.get_proportion_lists_vectorized(mean, one, labels, prop_type="quantile"))


show("level asked for", LEVELS)
raw, worse = shares(1, 1, False), shares(1, 1, True)
show("labels under the quantile", raw)
said = np.array([get_proportion_under_quantile(one, one, new, level) for level in LEVELS])
show("  as get_proportion_under_quantile says", said)
show("labels under the recalibrated quantile", worse)
show("  if the bias were doubled", norm.cdf(norm.ppf(LEVELS) + 2))
turned = np.array([(new <= get_quantile(one, one, level, model(old, one))).mean() for level in LEVELS])
show("  with forecasts and labels exchanged for the fit", turned)
narrow = shares(0, 0.5, True)
show("recalibrated, without bias, but half as wide", narrow)


def error(**more):
    return uct.mean_absolute_calibration_error(one, one, new, vectorized=True, prop_type="quantile", **more)


before, after = error(), error(recal_model=model(one, old))
print(f"mean absolute calibration error as reported: {before:.3f}, and {after:.3f} after recalibration")
print(f"mean distance from the level of the shares above: {np.abs(raw - LEVELS).mean():.3f} and", end=" ")
print(f"{np.abs(worse - LEVELS).mean():.3f}")
doubled = np.abs(worse - norm.cdf(norm.ppf(LEVELS) + 2)).max() < 0.02
mirrored = np.abs(said - (1 - raw[::-1])).max() < 1e-9 and np.abs(said - raw).max() > 0.5
unseen = before > 0.2 and after < 0.02
right = np.abs(turned - LEVELS).max() < 0.02 and np.abs(narrow - LEVELS).max() < 0.02
raise SystemExit(0 if doubled and mirrored and unseen and right else 1)
END
