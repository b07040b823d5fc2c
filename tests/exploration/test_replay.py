"""Replay memory: what is written where, and what is read."""

import numpy as np
import pytest

from dropout_uncertainty.exploration.replay import ReplayMemory

R, D, C = 2, 3, 2


def rows(value):
    return np.full((R, D + C), value, dtype=np.float32) + np.arange(R, dtype=np.float32)[:, None] / 10


def fill(memory, count, slots):
    for i in range(count):
        memory.store(slots[i], rows(2 * i), rows(2 * i + 1))


def test_slots_fill_in_order_and_then_random_ones_are_overwritten():
    memory, rng = ReplayMemory(R, 5, D, C), np.random.default_rng(100)
    uniform = rng.random((4000, R, 1))
    plan = memory.plan(uniform, np.ones(4000, dtype=bool), extra=0)
    np.testing.assert_array_equal(plan.slots[:5], np.arange(5)[:, None].repeat(R, 1))
    counts = np.bincount(plan.slots[5:, 0], minlength=5)
    assert abs(counts / 3995 - 0.2).max() < 4 * (0.2 * 0.8 / 3995) ** 0.5
    np.testing.assert_array_equal(plan.slots[5:, 1], np.floor(uniform[5:, 1, 0] * 5))


def test_a_minibatch_is_drawn_from_the_filled_slots_only_and_carries_its_successors():
    memory, rng = ReplayMemory(R, 10, D, C), np.random.default_rng(100)
    plan = memory.plan(rng.random((4, R, 1 + 6)), np.ones(4, dtype=bool), extra=1)
    for step in range(4):
        memory.store(plan.slots[step], rows(2 * step), rows(2 * step + 1))
        read = memory.read(plan.rows[step]).numpy()
        assert read.shape == (R, 13, D + C)
        states, successors, current = read[:, :6, 0], read[:, 6:12, 0], read[:, 12]
        np.testing.assert_allclose(successors, states + 1)
        assert set(np.floor(states).flat) <= {2.0 * i for i in range(step + 1)}
        np.testing.assert_array_equal(current, rows(2 * step + 1))  # replica r reads its own rows
    assert memory.size == 4


def test_reading_reaches_every_transition_equally_often():
    memory, rng = ReplayMemory(1, 8, D, C), np.random.default_rng(100)
    memory.stored = 8
    read = memory.plan(rng.random((1000, 1, 1 + 64)), np.zeros(1000, dtype=bool), extra=0).rows.numpy()
    counts = np.bincount(read.reshape(1000, 2, 64)[:, 0].reshape(-1), minlength=16)[::2]
    assert abs(counts / 64_000 - 1 / 8).max() < 4 * (1 / 8 * 7 / 8 / 64_000) ** 0.5


def test_steps_without_a_write_leave_the_memory_as_it_is():
    memory = ReplayMemory(R, 4, D, C)
    plan = memory.plan(np.full((3, R, 2), 0.99), np.array([True, False, True]), extra=0)
    assert plan.slots[0, 0] == 0
    assert plan.slots[2, 0] == 1
    assert plan.rows[1].reshape(R, 2)[0, 0] == 0  # one transition so far
    assert plan.rows[2].reshape(R, 2)[0, 0] == 2


def test_the_current_state_can_be_set_without_a_transition():
    memory = ReplayMemory(R, 4, D, C)
    memory.observe(rows(7))
    plan = memory.plan(np.zeros((1, R, 1)), np.array([True]), extra=2)
    np.testing.assert_array_equal(memory.read(plan.rows[0]).numpy(), rows(7)[:, None].repeat(2, 1))
    assert memory.size == 0


def test_spread_takes_first_and_last_and_keeps_successors_apart():
    memory = ReplayMemory(R, 10, D, C)
    fill(memory, 9, np.arange(9)[:, None].repeat(R, 1))
    values = np.floor(memory.read(memory.spread(5)).numpy()[0, :, 0])
    np.testing.assert_array_equal(values, [0, 4, 8, 12, 16, 1, 5, 9, 13, 17])


def test_a_restored_memory_reads_the_same():
    memory, other = ReplayMemory(R, 4, D, C), ReplayMemory(R, 4, D, C)
    fill(memory, 3, np.arange(3)[:, None].repeat(R, 1))
    other.restore(memory.state())
    assert other.size == 3
    np.testing.assert_array_equal(other.memory, memory.memory)


def test_nothing_is_read_from_an_empty_memory():
    memory = ReplayMemory(1, 4, D, C)
    with pytest.raises(ValueError, match="got 3 of 0"):
        memory.spread(3)


def test_an_empty_memory_is_refused():
    with pytest.raises(ValueError, match="at least one transition"):
        ReplayMemory(1, 0, D, C)
