"""A grey prior by planes: of each channel what it is of that plane alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from posterior import models
from posterior.models.priors.denoiser import Denoiser, Statistics
from posterior.models.priors.planes import by_planes

SHAPE = (8, 8)


class Mixing(eqx.Module):
    """Every pixel that it is shown changes every other: three planes at once would be told."""

    strength: jax.Array
    channels: int = eqx.field(static=True, default=1)
    stride: int = eqx.field(static=True, default=1)

    def __call__(self, x, log_level):
        return self.strength * jnp.mean(x**2) * (jnp.roll(x, 1, axis=0) - x)


DENOISER = Denoiser(Mixing(jnp.asarray(0.3)), Statistics(0.3, 0.25, 0.01, 10.0))
GREY = {
    "score": models.ScorePrior(DENOISER, SHAPE),
    "energy": models.EnergyPrior(DENOISER, SHAPE),
    "field": models.GaussianField.fit(np.random.default_rng(0).random((1, 16, 16)), SHAPE),
}


@pytest.mark.parametrize("name", GREY)
def test_planes_are_independent_and_each_as_grey(x64, name):
    grey, colour = GREY[name], by_planes(GREY[name])
    x = jnp.asarray(np.random.default_rng(1).random((*SHAPE, 3)))
    planes = [x[..., i] for i in range(3)]
    expected = np.stack([grey.score(plane, 0.2) for plane in planes], axis=-1)
    np.testing.assert_allclose(colour.score(x, 0.2), expected, rtol=1e-4, atol=1e-4)
    if name != "score":
        total = sum(float(grey.log_prob(plane, 0.2)) for plane in planes)
        assert float(colour.log_prob(x, 0.2)) == pytest.approx(total, rel=1e-5)
    assert colour.start(jax.random.key(0)).shape == (*SHAPE, 3)


def test_only_grey_priors_go_by_planes():
    with pytest.raises(ValueError, match=r"a prior of shape \(8, 8, 3\)"):
        by_planes(by_planes(GREY["field"]))
