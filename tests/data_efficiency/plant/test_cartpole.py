"""The plant: against the original integrator, against physics, and as a batched, differentiable function."""

import math
from dataclasses import replace

import pytest
import torch

from dropout_uncertainty.data_efficiency.deep_pilco import learner
from dropout_uncertainty.data_efficiency.plant import cartpole
from dropout_uncertainty.data_efficiency.plant.cartpole import MATLAB, PAPER, PRESETS
from dropout_uncertainty.data_efficiency.plant.cost import cost, solved
from dropout_uncertainty.rng import generator

HALF_TURN = torch.tensor([0.0, 0, 0, math.pi], dtype=torch.float64)  # the original's angle is 0 where ours is pi
FRICTIONLESS = replace(MATLAB, friction=0.0)


def some_states(count, seed=100):
    return torch.randn(count, 4, generator=generator(seed), dtype=torch.float64) * torch.tensor([1.0, 2, 5, 3])


def energy(plant, state):
    """Return the mechanical energy [J]; zero for the pole at rest and level with the pivot."""
    _, v, w, theta = state.unbind(-1)
    m, length = plant.pole_mass, plant.pole_length
    kinetic = (plant.cart_mass + m) * v**2 / 2 - m * length * v * w * theta.cos() / 2 + m * length**2 * w**2 / 6
    return kinetic + m * plant.gravity * length * theta.cos() / 2


def test_one_step_maps_match_the_original_integrator(golden):
    for case in golden("plant"):
        states = case["states"] + HALF_TURN
        stepped = cartpole.step(MATLAB, states[:-1], case["force"][:, 0])
        assert (stepped - states[1:]).abs().max() < 1e-7


def test_whole_trajectories_match_where_the_pole_does_not_tumble(golden):
    cases = [case for case in golden("plant") if case["states"][:, 2].abs().max() < 10]
    assert len(cases) >= 2
    expected = torch.stack([case["states"] for case in cases]) + HALF_TURN
    forces = torch.stack([case["force"][:, 0] for case in cases])
    state = expected[:, 0]
    for t in range(forces.shape[1]):
        state = cartpole.step(MATLAB, state, forces[:, t])
        assert (state - expected[:, t + 1]).abs().max() < 1e-6


def test_derivative_energy_and_cost_match_the_original(golden, close):
    for case in golden("plant"):
        state = case["deriv_z"][:, 0] + HALF_TURN
        close(cartpole.derivative(MATLAB, state, case["deriv_f"]), case["deriv_dz"], name="derivative")
        close(energy(MATLAB, state), case["energy"], name="energy")
        assert (cost(MATLAB, case["states"][1:] + HALF_TURN) - case["cost"][:, 0]).abs().max() < 1e-12


def test_energy_is_kept_without_friction_and_force():
    state = some_states(8)
    before = energy(FRICTIONLESS, state)
    for _ in range(20):
        state = cartpole.step(FRICTIONLESS, state, torch.zeros(8, dtype=torch.float64))
    assert (energy(FRICTIONLESS, state) - before).abs().max() < 1e-5


def test_friction_takes_energy_and_work_is_force_times_distance():
    state, force = some_states(8), torch.full((8,), 3.0, dtype=torch.float64)
    rest = cartpole.step(MATLAB, state, torch.zeros(8, dtype=torch.float64))
    assert (energy(MATLAB, rest) < energy(MATLAB, state)).all()
    pushed = cartpole.step(FRICTIONLESS, state, force)
    work = force * (pushed[:, 0] - state[:, 0])
    torch.testing.assert_close(energy(FRICTIONLESS, pushed) - energy(FRICTIONLESS, state), work, rtol=0, atol=1e-6)


def test_integrator_is_of_fourth_order():
    state, force = some_states(16), torch.linspace(-10, 10, 16, dtype=torch.float64)
    exact = cartpole.step(MATLAB, state, force, 512)
    errors = [(cartpole.step(MATLAB, state, force, n) - exact).norm() for n in (16, 32)]
    assert 3.7 < math.log2(errors[0] / errors[1]) < 4.3


@pytest.mark.parametrize("theta", [0.0, math.pi])
def test_upright_and_hanging_are_fixed_points(theta):
    state = torch.tensor([0.3, 0, 0, theta], dtype=torch.float64)
    moved = cartpole.derivative(MATLAB, state, torch.zeros((), dtype=torch.float64))
    assert moved.abs().max() < 1e-14


def test_upright_is_unstable_and_hanging_swings_at_the_rods_frequency():
    nudge = torch.tensor([[0, 0, 0, 0.01], [0, 0, 0, math.pi + 0.01]], dtype=torch.float64)
    upright, hanging = cartpole.derivative(MATLAB, nudge, torch.zeros(2, dtype=torch.float64))[:, 2]
    assert upright > 0 > hanging
    # linearised with a free cart: w' = -6 (M + m) g theta / (l (4 (M + m) - 3 m))
    expected = -6 * 1.0 * MATLAB.gravity * 0.01 / (MATLAB.pole_length * (4 - 1.5))
    assert hanging.item() == pytest.approx(expected, rel=1e-3)


def test_tip_stands_over_the_cart_when_upright_and_leans_left_for_positive_angles():
    states = torch.tensor([[0.2, 0, 0, 0], [0.2, 0, 0, math.pi / 2]], dtype=torch.float64)
    expected = torch.tensor([[0.2, 0.6], [-0.4, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(cartpole.tip(PAPER, states), expected)


def test_batched_equals_one_at_a_time():
    state, force = some_states(6).reshape(2, 3, 4), torch.arange(6, dtype=torch.float64).reshape(2, 3)
    together = cartpole.step(PAPER, state, force, 8)
    alone = torch.stack([cartpole.step(PAPER, state[i, j], force[i, j], 8) for i in range(2) for j in range(3)])
    torch.testing.assert_close(together.reshape(6, 4), alone, rtol=1e-13, atol=1e-13)


def test_step_has_the_right_gradient():
    state, force = (some_states(3).requires_grad_(), torch.randn(3, generator=generator(101), dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda s, u: cartpole.step(MATLAB, s, u, 4), (state, force.requires_grad_()))


def test_rollout_hands_the_same_noisy_states_to_the_policy_and_clips_forces():
    start = cartpole.start_states(PAPER, (3,), generator(100, "start"))
    noise = cartpole.observation_noise(PAPER, (3, PAPER.steps + 1), generator(100, "noise"))
    seen = []

    def act(observed, t):
        seen.append(observed)
        return torch.full((3,), 50.0 if t == 0 else 1.0, dtype=torch.float64)

    trial = cartpole.rollout(PAPER, start, act, noise)
    torch.testing.assert_close(torch.stack(seen, 1), trial.observed[:, :-1], rtol=0, atol=0)
    torch.testing.assert_close(trial.observed - trial.states, noise)
    assert trial.forces[:, 0].tolist() == [10.0] * 3
    torch.testing.assert_close(trial.states[:, 1], cartpole.step(PAPER, start, trial.forces[:, 0]))
    assert trial.states.shape == (3, 26, 4)


def test_start_states_have_the_preset_mean_and_spread():
    for plant in PRESETS.values():
        states = cartpole.start_states(plant, (4000,), generator(100))
        torch.testing.assert_close(states.mean(0), HALF_TURN, rtol=0, atol=5 * plant.start_std / math.sqrt(4000))
        torch.testing.assert_close(
            states.std(0), torch.full((4,), plant.start_std, dtype=torch.float64), rtol=0.06, atol=0
        )


def test_solved_looks_at_the_end_of_the_trial_only():
    costs = torch.ones(2, PAPER.steps)
    costs[0, -5:], costs[1, -5:] = 0.19, 0.21
    assert solved(PAPER, costs).tolist() == [True, False]
    assert PAPER.solved_steps * PAPER.dt == pytest.approx(0.5)
    assert MATLAB.solved_steps * MATLAB.dt == pytest.approx(1.0)


def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"out of \['matlab', 'paper'\], got 'atari'"):
        cartpole.preset("atari")
    with pytest.raises(ValueError, match=r"along the last axis, got shape \(2, 5\)"):
        cartpole.step(PAPER, torch.zeros(2, 5), torch.zeros(2))
    with pytest.raises(ValueError, match=r"noise of shape \(1, 26, 4\), got \(1, 25, 4\)"):
        cartpole.rollout(PAPER, torch.zeros(1, 4), lambda x, t: x[:, 0], torch.zeros(1, 25, 4))
    with pytest.raises(ValueError, match="NaN or infinity at step 0"):
        cartpole.rollout(PAPER, torch.zeros(1, 4), lambda x, t: x[:, 0] * torch.nan, torch.zeros(1, 26, 4))
    with pytest.raises(ValueError, match="expected 25 costs"):
        solved(PAPER, torch.zeros(3, 40))
    with pytest.raises(ValueError, match="cannot be judged on its last 5"):
        solved(replace(PAPER, steps=3), torch.zeros(3, 3))
    with pytest.raises(ValueError, match=r"got list: use torch\.as_tensor"):
        cartpole._check_states([0.0, 0.0, 0.0, 3.1])


@pytest.mark.parametrize("shape", [(2,), (3, 1)])
def test_forces_that_fit_no_state_are_named(shape):
    with pytest.raises(ValueError, match="one force per state"):
        cartpole.step(PAPER, torch.zeros(3, 4), torch.zeros(shape))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start_mean": (0.0, 0.0, 0.0, 180.0)}, "is it in degrees?"),
        ({"pole_length": 0.0}, "positive lengths"),
        ({"dt": math.nan}, "dt must be a finite number"),
        ({"start_std": -0.1}, "no negative"),
        ({"steps": 0}, "a step or more"),
        ({"solved_steps": 0}, "a step or more"),  # would be judged on all steps
    ],
)
def test_plants_that_cannot_be_are_named(change, words):
    with pytest.raises(ValueError, match=words):
        replace(PAPER, **change)


def test_a_plant_that_is_too_stiff_to_be_integrated_is_refused():
    for plant in cartpole.PRESETS.values():
        cartpole.check_interval(plant)
    stiff = replace(cartpole.PAPER, pole_length=0.1, cart_mass=0.05, pole_mass=0.02)
    for plant in (stiff, replace(cartpole.PAPER, friction=2000.0), replace(stiff, friction=1e9)):
        with pytest.raises(ValueError, match="it is too stiff"):
            cartpole.check_interval(plant)
    with pytest.raises(ValueError, match="it is too stiff"):
        learner.start(replace(learner.OURS, plant=stiff), (100,))


def test_a_plant_that_does_not_move_is_a_plant():
    still = replace(PAPER, force_limit=0.0, start_std=0.0, observation_noise=0.0, gravity=0.0)
    state = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(cartpole.step(still, state, torch.zeros(()).double(), 2), state)
