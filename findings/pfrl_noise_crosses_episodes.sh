#!/usr/bin/env bash
# pfrl 0.4.0: DDPG's exploration noise goes on from one episode into the next.
#
# Guess: `AdditiveOU` starts anew with each episode, as in the algorithm of the paper that its documentation names
#   (Lillicrap et al., 2015).
# Seen: the agent does not tell its explorer that an episode has ended, and the process runs on. The first noise of an
#   episode correlates with the last one of the episode before by 0.85, one less theta, as within an episode: trials that
#   are meant to be repetitions from the same start share their exploration.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
python3 -m pip --python "$folder/venv" install --quiet --no-compile torch==2.15.0 numpy==2.3.5 pillow==12.0.0 \
  filelock==3.20.0 cloudpickle==3.1.2 gym-notices==0.1.0 packaging==25.0
python3 -m pip --python "$folder/venv" install --quiet --no-compile --no-deps gym==0.26.2 pfrl==0.4.0
"$folder/venv/bin/python" - 2> /dev/null <<'END'
import numpy as np
import torch
from pfrl.agents import DDPG
from pfrl.explorers import AdditiveOU
from pfrl.policies import DeterministicHead
from pfrl.replay_buffers import ReplayBuffer
from torch import nn

np.random.seed(0)
still = nn.Linear(1, 1)
nn.init.zeros_(still.weight)
nn.init.zeros_(still.bias)
policy, critic = nn.Sequential(still, DeterministicHead()), nn.Linear(2, 1)
adams = [torch.optim.Adam(part.parameters()) for part in (policy, critic)]
agent = DDPG(policy, critic, *adams, ReplayBuffer(100), 0.99, AdditiveOU(), gpu=-1, replay_start_size=10**6)
noise, state = np.zeros((3000, 3)), np.zeros(1, np.float32)
for episode in noise:
    for step in range(3):
        episode[step] = agent.act(state)[0]
        agent.observe(state, 0.0, step == 2, False)
within = np.corrcoef(noise[:, 1], noise[:, 2])[0, 1]
across = np.corrcoef(noise[:-1, 2], noise[1:, 0])[0, 1]
print(f"correlation of the noise of one step with the next: within an episode {within:.2f}, across its end {across:.2f}")
raise SystemExit(0 if abs(within - 0.85) < 0.05 and abs(across - 0.85) < 0.05 else 1)
END
