"""One test that every sampler passes: same key same draws, vmap = loop, resume = straight run."""

import blackjax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import posterior as ps
from posterior import models, samplers
from posterior.samplers.base import PopulationSampler, vmap_init, vmap_step

SAMPLERS = {
    "annealed": samplers.AnnealedLangevin(levels=4, steps=3),
    "annealed, polished": samplers.AnnealedLangevin(levels=4, steps=3, polish=4),
    "annealed, split": samplers.AnnealedLangevin(levels=4, steps=3, path="split"),
    "annealed, descent": samplers.AnnealedLangevin(levels=4, steps=3, descent=3),
    "split gibbs": samplers.SplitGibbs(iterations=4, moves=2, prior_steps=2),
    "daps": samplers.DAPS(levels=4, flow_steps=2, moves=2),
    "dps": samplers.DPS(levels=4),
    "kawar": samplers.Kawar(levels=4, steps=3),
    "snips": samplers.SNIPS(levels=4, steps=3),
    "thickening": samplers.Thickening(levels=4),
    "ula": samplers.ULA(1e-4),
    "mala": samplers.MALA(0.01),
    "mala, line integral": samplers.MALA(0.01, nodes=2),
    "nuts": samplers.BlackJAX(blackjax.nuts),
    "blackjax mala": samplers.BlackJAX(blackjax.mala, step_size=0.001),
    "smc": samplers.TemperedSMC(moves=2, leapfrog=2),
    "ensemble": samplers.Ensemble(),
}


def posterior_of(dtype, sampler):
    if isinstance(sampler, samplers.Thickening):
        return counted()
    denoising = isinstance(sampler, (samplers.Kawar, samplers.SNIPS))
    n = 6 if dtype is complex else 3
    means = np.random.default_rng(0).standard_normal((2, n)) / 4 + 0.5
    prior = models.GaussianMixture([0.6, 0.4], means, [0.04 * np.eye(n)] * 2, (3,), dtype)
    if dtype is complex and not denoising:
        optics = models.Fourier((3,), oversampling=2)
        likelihood = models.IntensityLikelihood(optics, models.Gaussian(0.05))
    else:
        likelihood = models.LinearLikelihood(models.Identity((3,)), models.Gaussian(0.05))
    problem = ps.Problem(likelihood, prior)
    return problem.condition(problem.simulate(jax.random.key(0))[1])


def counted():
    """For the sampler that knows counts alone."""
    prior = models.PixelPrior.gamma(3.0, 6.0, (3,), 101, perturbation="poisson")
    likelihood = models.LinearLikelihood(models.Identity((3,)), models.Poisson(50))
    problem = ps.Problem(likelihood, prior)
    return problem.condition(problem.simulate(jax.random.key(0))[1])


def run(post, sampler, key=5, **settings):
    settings = {"chains": 2, "draws": 6, "warmup": 20, "progress": False, **settings}
    return ps.sample(post, sampler, jax.random.key(key), **settings)


KINDS = {
    "float32-complex": ("float32", complex),
    "float64-real": ("float64", float),
    "float32-real": ("float32", float),
    "float64-complex": ("float64", complex),
}

# What `make test` runs of a sampler, the rest being left to the study: one kind, and none of one
# whose states have the shape of another's.
FAST = {
    "annealed": ("float32-complex",),
    "annealed, polished": (),
    "annealed, split": (),
    "mala": ("float64-real",),
    "ula": (),
    "mala, line integral": (),
    "nuts": (),
    "blackjax mala": (),
    "smc": ("float32-complex",),
    "ensemble": ("float64-real",),
    "annealed, descent": (),
    "split gibbs": ("float64-real",),
    "daps": (),
    "dps": (),
    "kawar": (),
    "snips": ("float64-real",),
    "thickening": (),
}


def case(name, kind):
    fast = kind in FAST[name]
    marks = [] if fast else [pytest.mark.slow]
    return pytest.param(*KINDS[kind], name, id=f"{name}-{kind}", marks=marks)


CASES = [
    case(name, kind)
    for name in SAMPLERS
    for kind in KINDS
    if name != "thickening" or "real" in kind
]


@pytest.mark.parametrize("precision, dtype, name", CASES, indirect=["precision"])
def test_conformance(precision, tmp_path, name, dtype):
    sampler = SAMPLERS[name]
    post = posterior_of(dtype, sampler)
    draws = run(post, sampler)
    assert draws.values.shape == (2, 6, 3)
    assert draws.values.dtype == post.dtype
    assert np.all(np.isfinite(draws.values))
    np.testing.assert_array_equal(draws.values, run(post, sampler).values)
    assert not np.array_equal(draws.values, run(post, sampler, key=6).values)
    np.testing.assert_allclose(
        draws.mean, draws.values.mean((0, 1)), rtol=1e-4, atol=1e-6, err_msg="streamed mean"
    )
    _check_resumed(post, sampler, draws, tmp_path)
    if not isinstance(sampler, samplers.Ensemble):
        _check_vmap_is_loop(post, sampler, precision)


def _check_resumed(post, sampler, straight, tmp_path):
    """A run that stops half-way goes on to the very same draws."""
    folder = tmp_path / "checkpoint"
    if isinstance(sampler, PopulationSampler):
        with _interrupted(after=2), pytest.raises(KeyboardInterrupt):
            run(post, sampler, checkpoint=folder)
    else:
        run(post, sampler, draws=3, checkpoint=folder)
    resumed = run(post, sampler, checkpoint=folder)
    np.testing.assert_array_equal(resumed.values, straight.values)
    np.testing.assert_array_equal(run(post, sampler, checkpoint=folder).values, straight.values)


def _interrupted(after):
    """Kill a run at its second save, before the file is written."""
    return _KillSaves(after)


class _KillSaves:
    def __init__(self, after):
        self.after = after

    def __enter__(self):
        from posterior.checkpoint import Checkpoint

        self.original = original = Checkpoint.save
        self.count = 0

        def save(store, *args):
            self.count += 1
            if self.count >= self.after:
                raise KeyboardInterrupt
            return original(store, *args)

        Checkpoint.save = save

    def __exit__(self, *error):
        from posterior.checkpoint import Checkpoint

        Checkpoint.save = self.original


def _check_vmap_is_loop(post, sampler, precision):
    """Batched states move as single ones do, to rounding, and each step is a pure function."""
    keys = jax.random.split(jax.random.key(1), 2)
    if isinstance(sampler, PopulationSampler):
        single = [sampler.init(k, post, 4) for k in keys]
        together = None
    else:
        single = [eqx.filter_jit(sampler.init)(k, post) for k in keys]
        together = eqx.filter_jit(vmap_init)(sampler, keys, post, None)
    step = eqx.filter_jit(sampler.step)
    for i in range(3):
        step_keys = [jax.random.fold_in(k, i) for k in keys]
        single = [step(k, s)[0] for k, s in zip(step_keys, single)]
        if together is not None:
            together, _ = eqx.filter_jit(vmap_step)(sampler, jnp.stack(step_keys), together)
    again = step(step_keys[0], single[0])[0]
    np.testing.assert_array_equal(
        sampler.position(again), sampler.position(step(step_keys[0], single[0])[0])
    )
    if together is not None:
        axes = type(together)(*(None if f in sampler.shared else 0 for f in together._fields))
        found = jax.vmap(sampler.position, in_axes=(axes,))(together)
        expected = jnp.stack([sampler.position(s) for s in single])
        tolerance = 1e-3 if precision == "float32" else 1e-9
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)
