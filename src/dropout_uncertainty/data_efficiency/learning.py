"""What the learners of section 5.4 share."""

__all__ = ["EXPERIMENT", "GROUP"]

EXPERIMENT = "data_efficiency"
#: Most repetitions of a unit of section 5.4, by device: on a CPU the time per repetition hardly falls beyond.
GROUP = {"cpu": 20, "cuda": 40}
