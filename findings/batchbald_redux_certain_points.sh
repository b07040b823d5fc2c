#!/usr/bin/env bash
# batchbald_redux 2.0.5: the points that are certain are asked for first.
#
# Guess: a point for which every draw gives class 0 with probability 1 scores 0, since 0 log 0 = 0.
# Seen: a log-probability of minus infinity makes the score NaN, and both the top-k of
#   `get_bald_batch` and the maximum of `get_batchbald_batch` take NaN for the largest value. The
#   points without any uncertainty are returned first, in silence; the contradicted one comes last.
#   A float32 softmax gives exact zeros as soon as two logits are some 104 apart.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile torch==2.13.0 numpy==2.3.5 tqdm==4.67.1 toma==1.1.0
python3 -m pip --python "$folder/venv" install --quiet --no-compile --no-deps batchbald_redux==2.0.5
cd "$folder"
"$folder/venv/bin/python" -W ignore - 2> /dev/null <<'END'
import math

import torch
from batchbald_redux.batchbald import get_bald_batch, get_batchbald_batch

logits = torch.tensor(
    [  # points, draws, classes
        [[3.0, 0.0], [0.0, 3.0]],  # the draws contradict each other
        [[120.0, 0.0], [120.0, 0.0]],  # certain
        [[0.0, 0.0], [0.0, 0.0]],  # the draws agree that they do not know
        [[120.0, 0.0], [120.0, 0.0]],  # certain
    ]
)
logs = logits.softmax(-1).log()
bald = get_bald_batch(logs, 3)
batch = get_batchbald_batch(logs, 1, 100)
print(f"BALD asks for points {bald.indices} with scores {bald.scores}")
print(f"BatchBALD asks for point {batch.indices} with score {batch.scores}")
first = sorted(bald.indices[:2]) == [1, 3] and batch.indices[0] in (1, 3)
raise SystemExit(0 if first and math.isnan(bald.scores[0]) and math.isnan(batch.scores[0]) else 1)
END
