#!/usr/bin/env bash
# PyTorch 2.15.0: on a CPU, seeds that differ only above their 32nd bit give the same numbers.
#
# Guess: `manual_seed` takes 64 bits, so two different seeds give different numbers, as in NumPy.
# Seen: the generator keeps all 64 bits and gives them back as `initial_seed()`, but draws by the lower 32 alone: the
#   whole states of the two differ in that note of the seed and nowhere else. Who makes seeds of streams by hashing, one for
#   each network, mask or worker, has 2^32 streams and not 2^64: of 100,000 of them two are expected to be one.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile torch==2.15.0 numpy==2.3.5
"$folder/venv/bin/python" - <<'END'
import numpy as np
import torch

first, second = (torch.Generator().manual_seed(seed) for seed in (7, 7 + 2**40))
kept = second.initial_seed() == 7 + 2**40
states = (first.get_state() != second.get_state()).sum().item()
same = torch.equal(torch.rand(1000, generator=first), torch.rand(1000, generator=second))
elsewhere = np.array_equal(*(np.random.default_rng(seed).random(1000) for seed in (7, 7 + 2**40)))
print(f"torch: the seed is kept: {kept}; bytes of the states that differ: {states}; same numbers: {same}")
print(f"numpy: same numbers: {elsewhere}")
raise SystemExit(0 if kept and same and states <= 8 and not elsewhere else 1)
END
