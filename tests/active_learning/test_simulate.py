"""A simulation on any data with any classifier: right counts, the same when resumed, and one sentence for the rest."""

import errno
import inspect
from dataclasses import fields
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from torch import nn

from dropout_uncertainty import rng
from dropout_uncertainty.active_learning import DropoutLearner, EnsembleLearner, SklearnLearner, simulate
from dropout_uncertainty.active_learning.loop import acquire
from dropout_uncertainty.active_learning.pools import Pool

NAMES = np.array(["ant", "bee", "cow"])


class Nearest:
    """A classifier as scikit-learn has them: probabilities fall with the distance from the means of the classes."""

    noise = 0.0
    seed = None

    def get_params(self):
        return {"noise": self.noise, "random_state": self.seed}

    def set_params(self, random_state):
        self.seed = random_state

    def fit(self, x, y):
        x = x + np.random.default_rng(self.seed).normal(size=x.shape) * self.noise
        self.classes_ = np.unique(y)
        self.means = np.stack([x[y == c].mean(0) for c in self.classes_])

    def predict_proba(self, x):
        distance = ((x[:, None] - self.means) ** 2).sum(-1)
        likely = np.exp(distance.min(-1, keepdims=True) - distance)
        return likely / likely.sum(-1, keepdims=True)


@pytest.fixture
def data():
    """Return 60 colour images of 2 × 2 pixels whose brightness tells the class, and the names of the classes."""
    generator = np.random.default_rng(100)
    classes = np.arange(60) % 3
    return classes[:, None, None, None] + 0.1 * generator.normal(size=(60, 3, 2, 2)), NAMES[classes]


def network():
    return nn.Sequential(nn.Flatten(), nn.Linear(12, 30), nn.BatchNorm1d(30), nn.ReLU(), nn.Dropout(), nn.Linear(30, 3))


def dropout_learner():
    return DropoutLearner(network, epochs=15, learning_rate=0.02)


def noisy():
    nearest = Nearest()
    nearest.noise = 0.5
    return SklearnLearner(nearest)


LEARNERS = {
    "one": lambda: SklearnLearner(Nearest()),
    "dropout": dropout_learner,
    "ensemble": lambda: EnsembleLearner(noisy(), 3),
    "bootstrap": lambda: EnsembleLearner(SklearnLearner(Nearest()), 3, bootstrap=True),
}


def same(first, second):
    return all(np.array_equal(getattr(first, f.name), getattr(second, f.name)) for f in fields(first))


@pytest.mark.parametrize("name", LEARNERS)
def test_every_learner_learns_until_the_pool_runs_out(data, name):
    curve = simulate(LEARNERS[name](), *data, acquisition="max-entropy", count=10, progress=False)
    assert curve.labels.tolist() == [6, 16, 26, 36, 45]
    assert len(np.unique(curve.points)) == 45
    assert sorted(data[1][curve.points[:6]]) == sorted([*NAMES, *NAMES])
    assert curve.error[-1] == 0


@pytest.mark.parametrize("name", LEARNERS)
@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_resumed_equals_uninterrupted(data, name, tmp_path):
    options = {"count": 5, "draws": 3, "progress": False, "test": 0.5}
    whole = simulate(LEARNERS[name](), *data, **options, rounds=3)
    path = tmp_path / "digits"
    short = simulate(LEARNERS[name](), *data, **options, rounds=2, checkpoint=path)
    assert same(simulate(LEARNERS[name](), *data, **options, rounds=3, checkpoint=path), whole)
    assert short.points.tolist() == whole.points[:16].tolist()
    assert same(simulate(LEARNERS[name](), *data, **options, rounds=2, checkpoint=path), short)
    with pytest.raises(ValueError, match="of another simulation"):
        simulate(LEARNERS[name](), *data, **{**options, "draws": 4}, checkpoint=path)
    with pytest.raises(ValueError, match="of another simulation"):
        simulate(LEARNERS[name](), data[0] + 1, data[1], **options, checkpoint=path)
    stored = path.read_bytes()
    flipped = (stored[:at] + bytes([stored[at] ^ 1]) + stored[at + 1 :] for at in range(0, len(stored), 99))
    for damaged in (stored[:100], *flipped):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="is damaged or no checkpoint"):
            simulate(LEARNERS[name](), *data, **options, checkpoint=path)


def test_a_killed_simulation_goes_on(data, tmp_path):
    class Killed(SklearnLearner):
        fits = 0

        def fit(self, labelled):
            self.fits += 1
            if self.fits == 3:
                raise KeyboardInterrupt
            super().fit(labelled)

    options = {"acquisition": "least-confidence", "rounds": 3, "progress": False, "checkpoint": tmp_path / "c"}
    with pytest.raises(KeyboardInterrupt):
        simulate(Killed(Nearest()), *data, **options)
    resumed = Killed(Nearest())
    assert simulate(resumed, *data, **options).labels.tolist() == [6, 16, 26, 36]
    assert resumed.fits == 2


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_types_of_data_make_no_difference(data):
    images, labels = data[0].reshape(60, 12).astype(np.float32), data[1]
    number = np.unique(labels, return_inverse=True)[1]
    bare = simulate(SklearnLearner(Nearest()), images, labels, rounds=1, progress=False)
    for x, y in [
        (torch.from_numpy(images).requires_grad_(), torch.from_numpy(number)),
        (images.tolist(), labels.tolist()),
        (images[::-1][::-1], number.astype(np.int8)),
        (images.astype(">f4"), number.astype(">i8")),
        (np.asfortranarray(images).astype(np.float64), number.astype(np.float32)),
        (data[0].astype(np.float32), labels.astype(object)),
    ]:
        assert same(simulate(SklearnLearner(Nearest()), x, y, rounds=1, progress=False), bare)
    half = torch.from_numpy(images).bfloat16()
    assert simulate(SklearnLearner(Nearest()), half, labels, rounds=1, progress=False).labels.tolist() == [6, 16]
    coarse = (images * 50 + 50).astype(np.uint8)
    assert simulate(dropout_learner(), coarse, data[1], rounds=1, progress=False).labels.tolist() == [6, 16]
    assert simulate(SklearnLearner(Nearest()), coarse, number > 0, rounds=1, progress=False).labels.tolist() == [4, 14]


def test_a_class_may_have_no_label_and_the_test_set_may_be_chosen(data):
    images, labels = data
    mask = np.arange(60) < 30
    mask[labels == "cow"] = True  # all of one class
    curve = simulate(SklearnLearner(Nearest()), images, labels, test=mask, rounds=0, progress=False)
    assert curve.labels.tolist() == [4]
    assert not mask[curve.points].any()
    assert curve.error[0] == pytest.approx(100 * (labels[mask] == "cow").mean())
    chosen = simulate(SklearnLearner(Nearest()), images, labels, test=mask.nonzero()[0], rounds=0, progress=False)
    assert same(chosen, curve)


def test_a_learner_of_ones_own_names_all_classes(data):
    class Seen(SklearnLearner):
        def log_probs(self, candidates, draws):
            return super().log_probs(candidates, draws)[..., :2].log_softmax(-1)

    with pytest.raises(ValueError, match=r"all 3 classes, in the order of np.unique\(labels\), got 2"):
        simulate(Seen(Nearest()), *data, rounds=0, progress=False)


def test_a_learner_of_ones_own_and_the_picture(data):
    class Own:
        def fit(self, labelled):
            self.size = labelled.shape[1]

        def log_probs(self, candidates, draws):
            logits = np.arange(3.0) * candidates.numpy()[:, None, :, None].repeat(max(draws, 1), 1)
            return torch.from_numpy(logits).log_softmax(-1).numpy()

    curve = simulate(Own(), *data, acquisition="max-entropy", rounds=2, progress=False)
    assert str(curve) == f"max-entropy: 26 labels, test error {curve.error[-1]:.1f} %"
    _, ax = plt.subplots()
    np.testing.assert_array_equal(curve.plot(ax, label="mine").lines[0].get_xydata()[:, 0], [6, 16, 26])
    assert ax.get_legend_handles_labels()[1] == ["mine"]
    plt.close()


@pytest.mark.parametrize(("value", "message"), [(np.nan, "has the training diverged"), (1.0, "sum to 1")])
def test_what_is_no_prediction_has_no_test_error(data, value, message):
    class Broken:
        def fit(self, labelled):
            pass

        def log_probs(self, candidates, draws):
            return torch.full((1, 1, candidates.shape[1], 3), value)

    with pytest.raises(ValueError, match=message):  # though random acquisition asks for no scores
        simulate(Broken(), *data, acquisition="random", rounds=1, progress=False)


def test_a_classifier_that_names_no_classes(data):
    class Bare(Nearest):
        def fit(self, x, y):
            super().fit(x, y)
            self.known = self.__dict__.pop("classes_")

    options = {"acquisition": "max-entropy", "rounds": 1, "progress": False}
    assert same(
        simulate(SklearnLearner(Bare()), *data, **options), simulate(SklearnLearner(Nearest()), *data, **options)
    )
    cows = data[1] == "cow"
    with pytest.raises(ValueError, match=r"expected probabilities \[\d+, 3\], points × classes, got shape \[\d+, 2\]"):
        simulate(SklearnLearner(Bare()), *data, **options, test=cows)


def test_weight_draws_are_dropout_alone(data):
    learner = dropout_learner()
    learner.hold(torch.from_numpy(data[0]), torch.arange(60) % 3, 3, 100)
    learner.fit(torch.arange(12)[None])
    alone, among = learner.log_probs(torch.tensor([[20]]), 0), learner.log_probs(torch.arange(20, 40)[None], 0)
    torch.testing.assert_close(alone[:, :, 0], among[:, :, 0])  # batch normalisation is not in training mode
    draws = learner.log_probs(torch.arange(20, 40)[None], 50)
    assert draws.shape == (1, 50, 20, 3)
    assert draws.exp().std(1).mean() > 0.01


def test_batch_normalisation_in_training_mode_gets_a_hint(data):
    class Forgetful:
        def fit(self, labelled):
            self.network = network()

        def log_probs(self, candidates, draws):
            return self.network(torch.randn(candidates.shape[1], 12)).log_softmax(-1)[None, None]

    learner, pools = Forgetful(), [Pool([0], range(1, 9))]
    with torch.random.fork_rng():
        learner.fit(None)
        with pytest.warns(UserWarning, match=r"batch normalisation in training mode.*call eval"):
            acquire(learner, pools, "max-entropy", 2, draws=0, generators=[rng.generator(100)])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"labels": np.linspace(0, 1, 60)}, "a regression is out of scope"),
        ({"labels": np.array([0.0, np.nan] * 30)}, "fractions, NaN or infinity"),
        ({"labels": np.array([0.0, np.inf] * 30)}, "fractions, NaN or infinity"),
        ({"labels": ["ant", np.nan, "bee"] * 20}, "one type that has an order"),
        ({"labels": np.array(["2026-01-01", "NaT"] * 30, "datetime64[D]")}, "some of the labels are NaN"),
        ({"labels": np.ma.masked_equal(np.arange(60) % 3, 2)}, "some of the labels are masked"),
        ({"images": np.ma.masked_equal(np.ones((60, 2)), 1)}, "without masked values"),
        ({"labels": np.array([None, "ant"] * 30, dtype=object)}, "one type that has an order"),
        ({"labels": np.zeros(60)}, "at least two classes, got 1"),
        ({"labels": np.eye(3)[np.arange(60) % 3]}, "one label for each"),
        ({"labels": np.arange(59) % 3}, r"got shapes \[60, 2\] and \[59\]"),
        ({"images": np.full((60, 2), np.nan)}, "NaN or infinite"),
        ({"images": [[1], [2, 3]] * 30}, "real numbers in one array"),
        ({"images": np.array([["a"]] * 60)}, "real numbers in one array"),
        ({"images": np.arange(60)}, "one label for each"),
        ({"test": 1.0}, "share between 0 and 1"),
        ({"test": -0.1}, "share between 0 and 1"),
        ({"test": "a"}, "share between 0 and 1"),
        ({"test": [60]}, "indices below 60"),
        ({"test": [-1]}, "count from 0, got -1"),
        ({"test": [1, 1, 2]}, "repeat an index"),
        ({"test": [0, 1] * 30}, "is it a mask"),
        ({"test": np.arange(30) < 5}, "a mask over all 60 points as test points, got one over 30"),
        ({"labels": np.array([0.0, 1.0, np.nan] * 20, dtype=object)}, "some of the labels are NaN"),
        ({"checkpoint": Path("nowhere", "file")}, "should be a file in a folder that is there"),
        ({"checkpoint": Path()}, "should be a file in a folder that is there"),
        ({"acquisition": "entropy"}, "unknown acquisition function 'entropy'"),
        ({"count": 0}, "at least 1, got 0"),
        ({"rounds": -1}, "at least 0, got -1"),
        ({"draws": -1}, "at least 0, got -1"),
        ({"subset": 0}, "at least 1, got 0"),
        ({"learner": SklearnLearner}, "expected a learner"),
        ({"learner": DropoutLearner(lambda: nn.Linear(2, 3))}, "3 classes|images × classes|Dropout"),
    ],
)
def test_one_sentence_for_what_cannot_be_done(data, change, message):
    given = {"learner": SklearnLearner(Nearest()), "images": data[0].reshape(60, 12)[:, :2], "labels": data[1]} | change
    with pytest.raises(ValueError, match=message):
        simulate(**given, progress=False)


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ([nn.Dropout(), nn.Linear(12, 2)], r"logits \[6, 3\], images × classes, got \[6, 2\]"),
        ([nn.Dropout(), nn.Linear(12, 3), nn.Softmax(-1)], "ends in a softmax"),
        ([nn.Linear(12, 3)], "need an nn.Dropout layer"),
        ([nn.Dropout(0.0), nn.Linear(12, 3)], "need an nn.Dropout layer that drops something"),
    ],
)
def test_a_module_that_will_not_do_is_named(data, layers, message):
    with pytest.raises(ValueError, match=message):
        simulate(DropoutLearner(lambda: nn.Sequential(nn.Flatten(), *layers)), *data, progress=False)


class Activated(nn.Module):
    """A network whose settings and activation do not show in its repr."""

    def __init__(self, activation):
        super().__init__()
        self.activation = activation
        self.layers = nn.ModuleList([nn.Linear(12, 8), nn.Dropout(), nn.Linear(8, 3)])

    def forward(self, x):
        first, dropout, last = self.layers
        return last(dropout(self.activation(first(x.flatten(1)))))


def test_a_checkpoint_is_of_one_network_and_one_shape(data, tmp_path):
    def run(activation=torch.relu, images=data[0], make=Activated, name="c"):
        learner = DropoutLearner(lambda: make(activation), epochs=1)
        return simulate(learner, images, data[1], rounds=1, checkpoint=tmp_path / name, progress=False)

    first = run()
    assert same(run(), first)
    with pytest.raises(ValueError, match="of another simulation"):
        run(torch.tanh)
    with pytest.raises(ValueError, match="of another simulation"):
        run(images=data[0].reshape(60, 12))

    def biased(activation):
        network = Activated(activation)
        nn.init.ones_(network.layers[0].bias)
        return network

    with pytest.raises(ValueError, match="of another simulation"):
        run(make=biased)


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_an_address_in_memory_makes_no_other_simulation(data, tmp_path):
    class Holding(Nearest):
        def get_params(self):
            return {"held": object()}

    for _ in range(2):
        with pytest.warns(UserWarning, match="is described by <object object at 0x"):
            simulate(SklearnLearner(Holding()), *data, rounds=1, checkpoint=tmp_path / "c", progress=False)


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_a_checkpoint_knows_every_number_of_an_array(data, tmp_path):
    class Weighted(Nearest):
        def get_params(self):
            return {"weights": self.weights}

    def run(weights):
        classifier = Weighted()
        classifier.weights = weights
        simulate(SklearnLearner(classifier), *data, rounds=1, checkpoint=tmp_path / "c", progress=False)

    run(np.ones(2_000))
    run(np.ones(2_000))
    with pytest.raises(ValueError, match="of another simulation"):
        run(np.ones(2_000) + 1e-9 * (np.arange(2_000) == 1_000))


def test_every_fit_begins_from_the_module_as_it_was_made(data):
    with torch.random.fork_rng():
        made = nn.Sequential(nn.Flatten(), nn.Dropout(), nn.Linear(12, 3))
    options = {"acquisition": "random", "rounds": 2, "progress": False}
    curves = [simulate(DropoutLearner(lambda: made, epochs=5), *data, **options) for _ in range(2)]
    assert same(*curves)


@pytest.mark.parametrize("acquisition", ["bald", "batch-bald", "power-bald"])
def test_members_that_are_all_the_same_do_not_choose(data, acquisition):
    learner = EnsembleLearner(SklearnLearner(Nearest()), 3)
    with pytest.warns(UserWarning, match="all scores are equal"):
        chosen = simulate(learner, *data, acquisition=acquisition, rounds=1, progress=False)
    with pytest.warns(UserWarning, match="all scores are equal"):
        alone = simulate(SklearnLearner(Nearest()), *data, acquisition=acquisition, rounds=1, progress=False)
    assert same(chosen, alone)  # by the same random numbers


def test_a_bootstrap_loses_no_class(data):
    class Counting(Nearest):
        def fit(self, x, y):
            assert np.bincount(y).tolist() == [2, 2, 2]
            super().fit(x, y)

    simulate(EnsembleLearner(SklearnLearner(Counting()), 20, bootstrap=True), *data, rounds=0, progress=False)


def test_class_weights_by_label_need_labels_that_are_numbered(data):
    class Weighted(Nearest):
        def get_params(self):
            return {"class_weight": {0: 2.0}}

    learner = EnsembleLearner(SklearnLearner(Weighted()))
    with pytest.raises(ValueError, match="class_weight is a dictionary"):
        simulate(learner, *data, rounds=0, progress=False)
    simulate(learner, data[0], np.arange(60) % 3, rounds=0, progress=False)


@pytest.mark.parametrize(
    "layers",
    [
        [nn.Flatten(2), nn.TransformerEncoderLayer(4, 2, 8), nn.Flatten(), nn.Dropout(), nn.Linear(12, 3)],
        [nn.Flatten(), nn.Linear(12, 8), nn.BatchNorm1d(8, track_running_stats=False), nn.Dropout(), nn.Linear(8, 3)],
    ],
    ids=["transformer", "batch-norm"],
)
def test_predictions_that_depend_on_their_company_get_a_hint(data, layers):
    learner = DropoutLearner(lambda: nn.Sequential(*layers), epochs=1)
    learner.hold(torch.tensor(data[0], dtype=torch.float32), torch.arange(60) % 3, 3, 100)
    with pytest.warns(UserWarning, match="in other company"):
        learner.fit(torch.arange(10)[None])


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_words_may_be_learned_from(data):
    words = np.arange(60)[:, None] % 3 + np.zeros((60, 4), int)
    layers = [lambda: nn.Embedding(3, 4), nn.Flatten, nn.Dropout, lambda: nn.Linear(16, 3)]
    learner = DropoutLearner(lambda: nn.Sequential(*(layer() for layer in layers)), learning_rate=0.05)
    assert simulate(learner, words, data[1], rounds=1, progress=False).error[-1] == 0


class Attention(nn.Module):
    """Attention of the pixels to each other; the only dropout is that inside."""

    def __init__(self):
        super().__init__()
        self.within = nn.MultiheadAttention(4, 2, dropout=0.5, batch_first=True)

    def forward(self, x):
        return self.within(x, x, x)[0]


class LastOutput(nn.GRU):
    """The outputs of a recurrent network after the last time."""

    def forward(self, x):
        return super().forward(x)[0][:, -1]


@pytest.mark.parametrize(
    "make",
    [
        lambda: [nn.TransformerEncoderLayer(4, 2, 8, dropout=0.5, batch_first=True), nn.Flatten(), nn.Linear(12, 3)],
        lambda: [Attention(), nn.Flatten(), nn.Linear(12, 3)],
        lambda: [LastOutput(4, 5, num_layers=2, dropout=0.5, batch_first=True), nn.Linear(5, 3)],
        lambda: [nn.Flatten(), nn.Linear(12, 8), nn.BatchNorm1d(8), nn.AlphaDropout(0.5), nn.Linear(8, 3)],
    ],
    ids=["transformer", "attention", "recurrent", "batch-norm"],
)
def test_draws_differ_wherever_a_layer_drops(data, make):
    learner = DropoutLearner(lambda: nn.Sequential(nn.Flatten(2), *make()), epochs=1)
    learner.hold(torch.tensor(data[0], dtype=torch.float32), torch.arange(60) % 3, 3, 100)
    learner.fit(torch.arange(10)[None])
    kept = {name: value.clone() for name, value in learner.network.state_dict().items()}
    drawn = learner.log_probs(torch.arange(60)[None], 5)[0]
    assert all(not torch.equal(drawn[0], other) for other in drawn[1:])
    assert torch.equal(*(learner.log_probs(torch.arange(60)[None], 0) for _ in range(2)))
    assert all(torch.equal(kept[name], value) for name, value in learner.network.state_dict().items())


def test_what_is_no_classifier_is_refused():
    with pytest.raises(ValueError, match="regression is out of scope"):
        SklearnLearner(nn.Flatten())
    with pytest.raises(ValueError, match="a class has to be called"):
        SklearnLearner(Nearest)
    with pytest.raises(ValueError, match="a function that makes a new module"):
        DropoutLearner(nn.Flatten())
    with pytest.raises(ValueError, match="expected an SklearnLearner or a DropoutLearner"):
        inspect.unwrap(EnsembleLearner.__init__)(None, Nearest())  # without the check of types under test


class Mixed(nn.Module):
    """A category, looked up, beside features that are real numbers."""

    def __init__(self):
        super().__init__()
        self.table, self.rest = nn.Embedding(3, 2), nn.Sequential(nn.Linear(3, 8), nn.Dropout(), nn.Linear(8, 2))

    def forward(self, x):
        return self.rest(torch.cat((self.table(x[:, 0].long()), x[:, 1:]), 1))


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_features_beside_an_embedding_keep_their_fractions():
    generator = np.random.default_rng(100)
    features = np.stack((generator.integers(3, size=80), generator.random(80)), 1)  # whole numbers would be all 0
    learner = DropoutLearner(Mixed, epochs=100, learning_rate=0.05)
    found = simulate(learner, features, features[:, 1] > 0.5, count=20, rounds=2, progress=False)
    assert found.error[-1] < 20


class Dropped(nn.Module):
    """Dropout that does not show as a layer, in training or always."""

    def __init__(self, always=False):
        super().__init__()
        self.always = always

    def forward(self, x):
        return nn.functional.dropout(x, 0.5, training=self.always or self.training)


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        (lambda: [Dropped(), nn.Dropout()], "takes no part in weight draws"),
        (lambda: [Dropped(always=True), nn.Dropout()], "random in evaluation mode too"),
        (lambda: [nn.Unflatten(1, (1, 12)), LastOutput(12, 12, dropout=0.5, batch_first=True)], "draws are the same"),
    ],
)
@pytest.mark.filterwarnings("ignore:dropout option adds dropout", "ignore:the network predicts an image differently")
def test_what_takes_no_part_in_draws_is_named(data, layers, message):
    learner = DropoutLearner(lambda: nn.Sequential(nn.Flatten(), *layers(), nn.Linear(12, 3)), epochs=1)
    learner.hold(data[0].astype(np.float32), np.arange(60) % 3, 3, 100)
    with pytest.warns(UserWarning, match=message):
        learner.fit(torch.arange(10)[None])


@pytest.mark.parametrize("name", LEARNERS)
def test_a_point_without_a_label_is_not_learned_from(data, name):
    learner, labels = LEARNERS[name](), np.arange(60) % 3
    labels[30:] = -1
    learner.hold(data[0].astype(np.float32), labels, 3, 100)
    learner.fit(torch.arange(30)[None])
    assert learner.log_probs(torch.arange(40, 50)[None], 2).shape[2:] == (10, 3)
    with pytest.raises(ValueError, match="got -1 for point 30: has it been labelled"):
        learner.fit(torch.arange(31)[None])
    with pytest.raises(ValueError, match="a whole number as label for each of 60 images, got"):
        learner.hold(data[0], labels[:50], 3, 100)


def test_training_that_diverged_is_named(data):
    learner = DropoutLearner(network, epochs=5, learning_rate=1e30)
    learner.hold(data[0].astype(np.float32), np.arange(60) % 3, 3, 100)
    with pytest.raises(ValueError, match="has the training diverged"):
        learner.fit(torch.arange(10)[None])


class Shuffling(Nearest):
    """Draws from NumPy's global random state, as some splitters do."""

    def fit(self, x, y):
        super().fit(x + np.random.normal(size=x.shape), y)  # noqa: NPY002


def test_the_global_random_state_is_a_function_of_the_seed_and_not_moved(data):
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    one, two = (simulate(SklearnLearner(Shuffling()), *data, acquisition="margin", progress=False) for _ in range(2))
    assert same(one, two)
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002


def test_an_ensemble_of_ensembles_is_refused():
    with pytest.raises(ValueError, match="expected an SklearnLearner or a DropoutLearner"):
        EnsembleLearner(EnsembleLearner(noisy()))


class Placed(nn.Module):
    """Images beside a learned table of their pixels' places."""

    def __init__(self):
        super().__init__()
        self.seen, self.places = nn.Conv2d(3, 4, 2), nn.Embedding(4, 4)
        self.rest = nn.Sequential(nn.Dropout(), nn.Linear(4, 3))

    def forward(self, x):
        return self.rest(self.seen(x).flatten(1) + self.places(torch.arange(4)).mean(0))


class Penalised(nn.Module):
    """Keeps a tensor of its last pass in training, as losses beside the main one do, and moves a buffer."""

    def __init__(self):
        super().__init__()
        normal = nn.utils.parametrizations.spectral_norm(nn.Linear(12, 8))
        self.layers = nn.Sequential(nn.Flatten(), normal, nn.Dropout(), nn.Linear(8, 3))

    def forward(self, x):
        found = self.layers(x)
        if self.training:
            self.penalty = found.square().mean()
        return found


@pytest.mark.parametrize("make", [Placed, Penalised])
@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_modules_that_are_all_right_are_taken_without_a_word(data, make, recwarn):
    images = (60 * (data[0] - data[0].min())).astype(np.uint8)
    found = simulate(DropoutLearner(make, epochs=60, learning_rate=0.02), images, data[1], rounds=2, progress=False)
    assert found.error[-1] < 50
    assert not [str(warning.message) for warning in recwarn if "random" in str(warning.message)]


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_a_fit_by_the_caller_is_no_other_simulation_unless_training_goes_on_from_it(data, tmp_path):
    class Fitted(Nearest):
        warm_start = False

        def get_params(self):
            return super().get_params() | {"warm_start": self.warm_start}

    def run(classifier):
        simulate(SklearnLearner(classifier), *data, rounds=1, checkpoint=tmp_path / "c", progress=False)

    classifier = Fitted()
    run(classifier)
    classifier.fit(data[0].reshape(60, -1), np.arange(60) % 3)
    run(classifier)
    Fitted.warm_start = True
    (tmp_path / "c").unlink()
    run(Fitted())
    with pytest.raises(ValueError, match="of another simulation"):
        run(classifier)


def test_generators_that_look_alike_are_named(data, tmp_path):
    classifier = Nearest()
    classifier.noise = np.random.RandomState(1)
    with pytest.warns(UserWarning, match=r"is described by RandomState\(MT19937\)"), pytest.raises(TypeError):
        simulate(SklearnLearner(classifier), *data, rounds=1, checkpoint=tmp_path / "c", progress=False)


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_words_given_as_floats_are_words(data):
    words = np.arange(60)[:, None] % 3 + np.zeros((60, 4))
    layers = [lambda: nn.Embedding(3, 4), nn.Flatten, nn.Dropout, lambda: nn.Linear(16, 3)]
    learner = DropoutLearner(lambda: nn.Sequential(*(layer() for layer in layers)), learning_rate=0.05)
    assert simulate(learner, words, data[1], rounds=1, progress=False).error[-1] == 0


@pytest.mark.filterwarnings("ignore:all scores are equal")
def test_a_checkpoint_that_cannot_be_written_is_named_before_any_training_and_a_finished_one_is_read(
    data, tmp_path, monkeypatch
):
    def run(rounds):
        return simulate(SklearnLearner(Nearest()), *data, rounds=rounds, checkpoint=tmp_path / "c", progress=False)

    def denied(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    done = run(2)
    monkeypatch.setattr("tempfile.TemporaryFile", denied)
    assert same(done, run(2))
    monkeypatch.setattr(SklearnLearner, "fit", None)
    with pytest.raises(ValueError, match="cannot be written: Permission denied"):
        run(3)
