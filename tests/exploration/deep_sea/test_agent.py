"""Agents in Deep Sea: how long a draw is held, what is remembered, whom an ensemble follows."""

import numpy as np
import pytest
import torch

from dropout_uncertainty.exploration.deep_sea.agent import Agent
from dropout_uncertainty.exploration.deep_sea.config import EPISODES, Config
from dropout_uncertainty.exploration.deep_sea.world import MOVE_COST, cell_count

N, SEEDS = 4, (100, 101, 102)


def agent(name="thompson", **settings):
    return Agent(Config(name, N, **{"hidden": (12, 8), "batch": 8, "discount": 0.7} | settings), SEEDS)


def play(made, blocks=1):
    """Return which cells were entered, and the draws acted on, [episodes, moves, R, ...]."""
    cells, draws, learn = [], [], made._learn

    def watched(step, draw):
        q = learn(step, draw)
        if made.masks.masks[1] is not None:
            draws.append(made.masks.masks[1][:, -1].numpy().copy())
        return q

    made._learn = watched
    for block in range(blocks):
        made.prepare(block)
        for number in range(EPISODES):
            made.episode(number, lambda cell: cells.append(cell.copy()))
    shape = (blocks * EPISODES, N, len(SEEDS))
    return np.reshape(cells, shape), np.reshape(draws, (*shape, -1)) if draws else None


def test_a_draw_is_held_for_a_move_or_for_an_episode():
    drop = (0.0, 0.5, 0.0)
    _, held = play(agent(held="episode", drop=drop))
    assert (held == held[:, :1]).all()
    assert (held[1:, 0] != held[:-1, 0]).any(axis=(1, 2)).all()
    _, fresh = play(agent(held="move", drop=drop))
    assert (fresh[:, 1:] != fresh[:, :-1]).any(axis=(2, 3)).all()
    _, mean = play(agent("greedy", drop=drop))
    assert (mean == 1).all()  # learns with dropout, acts without


def test_the_memory_holds_what_happened():
    made = agent("boltzmann", memory=200)
    cells, _ = play(made, 2)
    sea, moves = made.sea, 2 * EPISODES * N
    memory = made.memory.memory.view(len(SEEDS), -1, 3).numpy()
    before, after = memory[:, 0 : 2 * moves : 2], memory[:, 1 : 2 * moves : 2]
    np.testing.assert_array_equal(before[..., 0], cells.reshape(moves, -1).T)
    assert (before[..., 1:].sum(-1) == 1).all()
    step = np.tile(np.arange(N), 2 * EPISODES)
    column = before[..., 0].astype(int) - step * (step + 1) // 2
    right = before[..., 1:].argmax(-1) == sea.mapping[np.arange(len(SEEDS))[:, None], step, column]
    treasure = right & (column == N - 1)
    np.testing.assert_allclose(after[..., 1], treasure - MOVE_COST / N * right, atol=1e-7)
    np.testing.assert_array_equal(after[..., 2], np.broadcast_to(step < N - 1, after.shape[:2]))
    going_on = (step < N - 1)[:-1]
    np.testing.assert_array_equal(after[:, :-1, 0][:, going_on], before[:, 1:, 0][:, going_on])


def test_a_member_of_an_ensemble_learns_from_its_share():
    made = agent("greedy", members=5, share=0.5, memory=400)
    play(made, 5)
    taken = made.memory.memory.view(len(SEEDS), 5, -1, 3)[..., : 2 * made.memory.size : 2, 1:].sum(-1)
    assert set(taken.unique().tolist()) == {0.0, 1.0}
    assert taken.mean().item() == pytest.approx(0.5, abs=4 * 0.5 / taken.numel() ** 0.5)
    assert (taken[:, 0] != taken[:, 1]).any()


def test_an_ensemble_follows_one_member_through_an_episode():
    made = agent("greedy", members=3, prior_scale=2.0, learning_rate=1e-30)
    cells, _ = play(made)
    every = torch.arange(cell_count(N)).repeat(3 * len(SEEDS), 1)
    q = (made.network.forward(every)[-1] + made.prior).view(len(SEEDS), 3, -1, 2).numpy()
    assert len(np.unique(made.follows)) == 3
    for replica in range(len(SEEDS)):
        for episode in range(EPISODES):
            column = 0
            for row in range(N):
                cell = row * (row + 1) // 2 + column
                assert cells[episode, row, replica] == cell
                action = q[replica, made.follows[episode, replica], cell].argmax()
                column = max(0, column + 1 if action == made.sea.mapping[replica, row, column] else column - 1)


def test_members_have_draws_of_their_own_and_the_first_those_of_an_agent_without_others():
    drop = (0.0, 0.5, 0.0)
    made, single = (agent(members=members, drop=drop) for members in (3, 1))
    for one in (made, single):
        one.prepare(0)
    masks, alone = ((one.masks.at(0)[1], one.draws.at(0)[1]) for one in (made, single))
    for mask, of_one in zip(masks, alone, strict=True):
        by_member = mask.view(len(SEEDS), 3, *mask.shape[1:])
        assert torch.equal(by_member[:, 0], of_one)
        assert not torch.equal(by_member[:, 0, :1], by_member[:, 1, :1])
        assert not torch.equal(by_member[:, 1, :1], by_member[:, 2, :1])


def test_members_and_priors_start_differently():
    made = agent("greedy", members=3, prior_scale=1.0)
    rows = torch.cat((made.network.parameters, made._networks("prior").parameters))
    assert len(rows.unique(dim=0)) == 2 * 3 * len(SEEDS)
