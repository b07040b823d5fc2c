"""Learners without a model: the report of `model_free.learner`."""
