"""Deep PILCO learns to swing up a cart-pole of your own, and plays one trial of what it has learned in Gymnasium.

python examples/your_own_plant.py 10   # trials; some minutes
"""

import sys
from dataclasses import replace

import gymnasium
import numpy as np
import torch

from dropout_uncertainty.data_efficiency.deep_pilco.learner import OURS, start
from dropout_uncertainty.data_efficiency.plant.cartpole import CartPole
from dropout_uncertainty.data_efficiency.policies import force

plant = CartPole(pole_length=0.8, pole_mass=0.3, steps=30, start_std=0.02, solved_steps=5, cost_width=0.3)
small = {"model_steps": 20, "policy_steps": 5, "guard": 1.0} if sys.argv[2:] == ["small"] else {}
run = start(replace(OURS, plant=plant, trials=int(sys.argv[1]), **small), seeds=[100])
while run.done < run.total:
    print(run.advance())
env = gymnasium.make("dropout_uncertainty/CartPoleSwingUp-v0", plant=plant)
seen, ended, total, policy = env.reset(seed=100)[0], False, 0.0, run.shape.policy(run.policy)
while not ended:
    observed = torch.tensor(seen).to(run.policy).view(1, 1, 4)
    share = force(policy, plant, observed).item() / plant.force_limit
    seen, reward, _, ended, _ = env.step(np.array([share], np.float32))
    total += reward
print(f"one more trial: mean cost {1 - total / plant.steps:.2f} per step")
