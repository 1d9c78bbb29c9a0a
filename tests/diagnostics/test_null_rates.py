"""How often right draws are called wrong, by the verdicts that users read."""

from functools import partial

import jax
import numpy as np
import pytest
import scipy.stats

from posterior.diagnostics import beside_floor, certificate, certify, sliced_wasserstein
from posterior.diagnostics.beside_exact import Beside
from posterior.models.gallery import linear_gaussian

pytestmark = pytest.mark.slow

REPETITIONS = 400


def test_false_alarms_beside_the_floor_are_as_many_as_stated():
    rng, alarms = np.random.default_rng(0), 0
    distance = partial(sliced_wasserstein, projections=5)
    for _ in range(REPETITIONS):
        draws, reference = rng.standard_normal((12, 3)), rng.standard_normal((30, 3))
        found = beside_floor(draws, reference, rng, distance, repeats=2, permutations=19)
        alarms += found.p <= 0.05
    print(f"\n{alarms} of {REPETITIONS} fail")
    least, most = scipy.stats.binom(REPETITIONS, 0.05).interval(0.99)
    assert least <= alarms <= most


def test_certificates_of_an_exact_sampler_fail_as_often_as_stated(monkeypatch):
    """On two unknowns; the quantities depend on each other, so that fewer than 5 % may fail.

    The comparison with exact draws has no say in the verdict, and is left out.
    """
    monkeypatch.setattr(certificate, "beside_exact", lambda *_: Beside())
    known = linear_gaussian(size=2, rows=1)

    def exact(key, posterior):
        return known.exact(key, posterior.y, 20)[None]

    found = [
        certify(exact, {"it": known}, jax.random.key(i), 40, progress=False)["it"]
        for i in range(REPETITIONS)
    ]
    alarms = sum(one.kind == "fails" for one in found)
    raw = np.array([one.calibration._raw_p for one in found])
    names = found[0].calibration.names
    by_quantity = dict(zip(names, np.sum(raw < 0.05, axis=0).tolist()))
    print(f"\n{alarms} of {REPETITIONS} fail; by one quantity alone: {by_quantity}")
    law = scipy.stats.binom(REPETITIONS, 0.05)
    least, most = law.interval(0.99)
    assert least <= alarms <= most
    # Each by itself at its level, all of them within the interval that holds them together.
    least, most = law.interval(1 - 0.01 / len(names))
    assert all(least <= count <= most for count in by_quantity.values())
