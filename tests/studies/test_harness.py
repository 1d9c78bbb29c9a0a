"""Answers are computed once, in a process of their own, and a stopped study goes on."""

import os
from typing import NamedTuple

import numpy as np
import pytest

from posterior.studies import measure

IDENTITY = {"study": "of the test", "seed": 0}


class Work(NamedTuple):
    """Writes down each call; `stop` and `dies`: where it is interrupted, and its process killed."""

    folder: str
    stop: int = -1
    dies: int = -1
    broad: bool = False

    def __call__(self, system, condition, index):
        if index == self.stop:
            raise KeyboardInterrupt
        if index == self.dies:
            os._exit(1)
        if system == "narrow-minded" and not self.broad:
            raise ValueError("only for blue pictures")
        if system == "without weights":
            raise FileNotFoundError("no weights for counts")
        if system == "diverging":
            return np.array([[np.inf]])
        with open(os.path.join(self.folder, "calls"), "a") as file:
            file.write(f"{os.getpid()} {system} {condition} {index}\n")
        return np.full((2, 3), float(index))


def calls(folder):
    with open(os.path.join(folder, "calls")) as file:
        return [line.split() for line in file]


def answered(folder, work, systems, count=3, identity=IDENTITY):
    found = measure(folder / "answers", identity, systems, ["0.1"], count, work)
    return {system: answer for system, _, _, answer in found if answer is not None}


def test_a_stopped_study_goes_on_without_repeating_an_answer(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        answered(tmp_path, Work(str(tmp_path), stop=2), ["plain"])
    assert [call[3] for call in calls(tmp_path)] == ["0", "1"]
    found = answered(tmp_path, Work(str(tmp_path)), ["plain", "other"])
    assert [call[1:] for call in calls(tmp_path)] == [
        *(["plain", "0.1", str(i)] for i in range(3)),
        *(["other", "0.1", str(i)] for i in range(3)),
    ]
    processes = {call[1]: call[0] for call in calls(tmp_path)[2:]}
    assert processes["plain"] != processes["other"] != str(os.getpid())
    expected = np.broadcast_to(np.arange(3.0)[:, None, None], (3, 2, 3))
    for answer in found.values():
        np.testing.assert_array_equal(answer.images, expected)
        assert answer.seconds.shape == (3,) and answer.seconds.min() >= 0
        assert answer.memory > 1e7 or os.name == "nt"
    # More pictures of the same study are added to those that are there.
    assert answered(tmp_path, Work(str(tmp_path)), ["plain"], 4)["plain"].images.shape == (4, 2, 3)
    assert len(calls(tmp_path)) == 7


def test_a_system_that_does_not_apply_or_diverges_is_said_to(tmp_path):
    systems = ["narrow-minded", "diverging", "without weights"]
    found = answered(tmp_path, Work(str(tmp_path)), systems)
    assert found["without weights"].refusal == "recording 0: no weights for counts"
    assert found["narrow-minded"].refusal == "recording 0: only for blue pictures"
    assert found["diverging"].refusal == "recording 0: the answer is not finite"


def test_a_refusal_is_not_kept(tmp_path):
    """A package may be installed meanwhile."""
    work = Work(str(tmp_path))
    for _ in range(2):
        assert answered(tmp_path, work, ["narrow-minded"])["narrow-minded"].refusal
    found = answered(tmp_path, work._replace(broad=True), ["narrow-minded"])["narrow-minded"]
    assert not found.refusal and found.images.shape == (3, 2, 3)


def test_a_process_that_dies_is_said_to_and_loses_nothing(tmp_path):
    with pytest.raises(ValueError, match="the process of plain at 0.1 ended"):
        answered(tmp_path, Work(str(tmp_path), dies=1), ["plain"])
    assert answered(tmp_path, Work(str(tmp_path)), ["plain"])["plain"].images.shape == (3, 2, 3)
    assert [call[3] for call in calls(tmp_path)] == ["0", "1", "2"]


def test_another_study_is_refused_the_folder(tmp_path):
    answered(tmp_path, Work(str(tmp_path)), ["plain"], 1)
    with pytest.raises(ValueError, match="is of another campaign"):
        answered(tmp_path, Work(str(tmp_path)), ["plain"], 1, IDENTITY | {"seed": 1})
