#!/usr/bin/env bash
# mbrl 0.2.0: the planner MPPI tries the same actions whatever its noise scale `sigma` is.
#
# Guess: `sigma`, documented as the scale of the noise with which actions are sampled, is the standard deviation of
#   the actions that `MPPIOptimizer` tries about its plan (times 0.88, since the noise is cut at two deviations), as
#   long as the bounds leave room: 0.1 gives 0.09 and 10 gives 8.8. Another sigma gives another plan, and with bounds
#   of -100 and 100 and a sigma of 30 it finds a best action of 50, as `CEMOptimizer` does.
# Seen: with the same seed, sigmas from 0.001 to 1000 give the same population and the same plan to the last bit,
#   always with a deviation of 0.87. The noise is scaled by sigma and by the distance to the bounds, and then all of
#   that is overwritten with the plan plus unscaled noise. No action is more than 2 from the plan of the round before,
#   so of a best action of 50 it reaches 18 in ten rounds where CEM reaches 50, in the same bounds and with as many
#   tries; with bounds of -0.05 and 0.05, 95 % of what it tries lies on a bound, where a sigma of 0.01 should leave
#   none. How widely the planner explores is set by the unit of the actions alone. At a sigma of 1 in wide bounds
#   nothing shows.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv --without-pip "$folder/venv"
# hydra-core, omegaconf and gymnasium are newer than mbrl asks for; the optimisers only import them
python3 -m pip --python "$folder/venv" install --quiet --no-compile torch==2.13.0 numpy==2.3.5 hydra-core==1.3.2 \
  omegaconf==2.3.0 tqdm==4.67.1 termcolor==3.2.0 gymnasium==1.2.2
python3 -m pip --python "$folder/venv" install --quiet --no-compile --no-deps mbrl==0.2.0
cd "$folder"
"$folder/venv/bin/python" -W ignore - <<'END'
import torch
from mbrl.planning import CEMOptimizer, MPPIOptimizer

HORIZON, TRIES, ROUNDS = 2, 2000, 10


def limits(bound):
    return {"lower_bound": [[-bound]] * HORIZON, "upper_bound": [[bound]] * HORIZON, "device": torch.device("cpu")}


def search(planner, goal):
    """Return the actions a planner tries in its first round, and its plan, where each action should be the goal."""
    torch.manual_seed(0)
    tried = []
    plan = planner.optimize(
        lambda actions: -((actions - goal) ** 2).sum((1, 2)),
        x0=torch.zeros(HORIZON, 1),
        callback=lambda population, *_: tried.append(population.clone()),
    )
    return tried[0], plan


def mppi(sigma, bound, goal):
    return search(MPPIOptimizer(ROUNDS, TRIES, gamma=1.0, sigma=sigma, beta=1.0, **limits(bound)), goal)


def cem(bound, goal):
    return search(CEMOptimizer(ROUNDS, 0.05, TRIES, alpha=0.0, **limits(bound)), goal)


seen = {sigma: mppi(sigma, 10_000.0, 3.0) for sigma in (0.001, 0.1, 1.0, 10.0, 1000.0)}
for sigma, (tried, plan) in seen.items():
    print(f"sigma {sigma:8}: deviation of what is tried {tried.std():.4f}, plan {plan.flatten().tolist()}")
tried, plan = seen[1.0]
same = all(torch.equal(tried, other) and torch.equal(plan, found) for other, found in seen.values())
(narrow, short), (wide, found) = mppi(30.0, 100.0, 50.0), cem(100.0, 50.0)
print(f"best of 50, sigma 30: MPPI tries up to {narrow.abs().max():.2f} at first, plans {short.max():.2f};", end=" ")
print(f"CEM {wide.abs().max():.2f} and {found.max():.2f}")
tight = (mppi(0.01, 0.05, 0.0)[0].abs() == torch.tensor(0.05)).float().mean().item()
print(f"bounds of 0.05, sigma 0.01: {tight:.0%} of what is tried lies on a bound")
behind = short.max() < 25 and (found - 50).abs().max() < 1
raise SystemExit(0 if same and 0.8 < tried.std() < 0.95 and behind and tight > 0.9 else 1)
END
