"""Section 5.2: active learning with image data."""

from dropout_uncertainty.active_learning.learners import DropoutLearner, EnsembleLearner, SklearnLearner
from dropout_uncertainty.active_learning.simulate import Curve, simulate

__all__ = ["Curve", "DropoutLearner", "EnsembleLearner", "SklearnLearner", "simulate"]
