"""A draw held for an episode, by an agent with a few actions: python examples/hold_a_draw.py CartPole-v1 150."""

import random
import sys

import gymnasium
import torch
from gymnasium.wrappers import FlattenObservation

from dropout_uncertainty.bayes import MLP

env, episodes = FlattenObservation(gymnasium.make(sys.argv[1])), int(sys.argv[2])
q = MLP((env.observation_space.shape[0], 64, 64, int(env.action_space.n)), (0.0, 0.1, 0.1), seeds=[100])
adam, memory, chance, step = torch.optim.Adam(q.parameters(), 1e-3), [], random.Random(100), 0
for episode in range(episodes):
    (seen, _), masks, ended, total = env.reset(seed=episode), q.draw(1, "episode", episode), False, 0.0
    while not ended:
        best = q(torch.tensor(seen, dtype=torch.float32).view(1, 1, -1), masks).argmax()
        action = int(best) if step >= 1_000 else chance.randrange(env.action_space.n)
        after, reward, terminated, truncated, _ = env.step(action)
        memory.append((seen, action, reward, after, terminated))
        seen, ended, total, step = after, terminated or truncated, total + reward, step + 1
        batch = zip(*chance.choices(memory, k=64), strict=True)
        s, a, r, t, over = (torch.stack([torch.as_tensor(v, dtype=torch.float32) for v in column]) for column in batch)
        target = r + 0.98 * (1 - over) * q(t[None])[0].amax(-1).detach()  # by the mean weights
        loss = (q(s[None], q.draw(64, "learn", step))[0].gather(1, a.long()[:, None])[:, 0] - target).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    print(f"episode {episode}: return {total:g}")
