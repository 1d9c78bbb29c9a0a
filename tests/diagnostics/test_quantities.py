"""What calibration asks of an object and its recording, beside plain NumPy."""

import jax
import numpy as np
import pytest
import scipy.stats
from analytic import wiener

import posterior as ps
from posterior import models
from posterior.diagnostics import sbc, uniformity
from posterior.diagnostics.quantities import (
    DistanceToAmplitudes,
    HaarEnergy,
    PatchMean,
    default_quantities,
)
from posterior.models.gallery import two_pixel_retrieval
from posterior.models.priors import ScorePrior

SHAPES = [(8,), (8, 6), (9, 8, 3)]


def denoising(shape, dtype=float):
    size = int(np.prod(shape)) * (2 if dtype is complex else 1)
    prior = models.GaussianPrior(np.zeros(size), np.eye(size), shape, dtype)
    return ps.Problem(models.LinearLikelihood(models.Identity(shape), models.Gaussian(0.3)), prior)


@pytest.mark.parametrize(
    "shape, dtype",
    [
        *((shape, float) for shape in SHAPES),
        ((8, 6), complex),
        pytest.param((9, 8, 3), complex, marks=pytest.mark.slow),
    ],
)
def test_each_is_what_its_name_says(x64, shape, dtype):
    problem = denoising(shape, dtype)
    x, y = (np.asarray(a) for a in problem.simulate(jax.random.key(0)))
    found = {name: float(f(x, y)) for name, f in default_quantities(problem).items()}
    norm = np.sum(np.abs(x) ** 2)
    assert found["squared norm"] == pytest.approx(norm)
    assert sum(v for n, v in found.items() if "frequencies" in n) == pytest.approx(norm)
    assert found["distance to estimate"] == pytest.approx(np.sum(np.abs(x - y) ** 2))
    assert found["log-posterior"] == pytest.approx(found["log-likelihood"] + found["log-prior"])
    amplitude = np.abs(x) if dtype is complex else x
    first = [name for name in found if name.startswith("mean")][0]
    halves = tuple(slice(0, n // 2) for n in shape[:2])
    assert found[first] == pytest.approx(amplitude[halves].mean())
    assert sum(name.startswith("mean") for name in found) == 2 ** min(len(shape), 2)


def test_wavelets_see_the_scale_of_a_pattern():
    stripes = np.kron(np.ones((4, 1)), np.repeat([[1.0, -1.0]], 2, axis=1)).repeat(2, axis=0)
    energies = [float(HaarEnergy(scale, (0, 1))(stripes, None)) for scale in (0, 1)]
    # Two stripes two pixels wide in each of four rows of blocks: 2 apart, squared.
    assert energies == [0, 4 * 2**2]
    rough = np.indices((8, 4)).sum(axis=0) % 2 * 2.0 - 1
    energies = [float(HaarEnergy(scale, (0, 1))(rough, None)) for scale in (0, 1)]
    assert energies[0] == 8 * 4 / 2 * 2 * 4 and energies[1] == 0


def test_a_global_phase_changes_the_densities_alone(x64):
    problem = denoising((8, 6), complex)
    x, y = problem.simulate(jax.random.key(0))
    for name, f in default_quantities(problem).items():
        same = np.isclose(f(x, y), f(x * np.exp(1j), y))
        assert same == (name not in {"log-likelihood", "log-posterior", "distance to estimate"})


def test_a_dark_recording_suggests_a_dark_object():
    problem = denoising((8,))
    f = default_quantities(problem)["distance to estimate"]
    assert float(f(np.full(8, 0.5), np.zeros(8))) == 2.0


def test_a_real_object_behind_complex_optics_has_a_real_estimate(x64):
    prior = models.GaussianPrior(np.zeros(8), np.eye(8), (8,))
    likelihood = models.LinearLikelihood(models.Fourier((8,)), models.Gaussian(0.3))
    x, y = ps.Problem(likelihood, prior).simulate(jax.random.key(0))
    found = default_quantities(ps.Problem(likelihood, prior))["distance to estimate"](x, y)
    matrix = np.stack([likelihood.optics(row) for row in np.eye(8)], axis=1)
    back = matrix.conj().T @ y
    scale = np.vdot(matrix @ back, y).real / np.linalg.norm(matrix @ back) ** 2
    assert float(found) == pytest.approx(np.sum((np.asarray(x) - (scale * back).real) ** 2))


def test_amplitudes_are_compared_with_those_recorded(x64):
    """In plain NumPy; whatever the phase, and where read noise has made darkness negative."""
    optics = models.Fourier((4,), oversampling=2)
    likelihood = models.IntensityLikelihood(optics, models.Poisson(100), 0.5)
    x = jax.random.normal(jax.random.key(0), (4,)) + 0.3j
    y = np.linspace(-0.1, 1.0, 8)
    field = np.stack([optics(row) for row in np.eye(4)], axis=1) @ np.asarray(x)
    expected = np.sum((np.sqrt(0.5) * np.abs(field) - np.sqrt(np.maximum(y, 0))) ** 2)
    f = DistanceToAmplitudes(likelihood)
    assert float(f(x, y)) == pytest.approx(expected)
    assert float(f(x * np.exp(1j), y)) == pytest.approx(expected)
    with pytest.raises(ValueError, match="records a field, not its intensity"):
        DistanceToAmplitudes(denoising((4,)).likelihood)


@pytest.fixture(scope="module")
def retrieval():
    """Phase retrieval of two pixels, and its exact draws by importance."""
    known = two_pixel_retrieval(proposals=1000)
    return known, ps.Problem(known.likelihood, known.prior)


def ranks_in_amplitudes(retrieval, drawer, count):
    known, problem = retrieval
    asked = {"amplitudes": DistanceToAmplitudes(known.likelihood)}
    found = sbc(
        problem, drawer, jax.random.key(0), count, quantities=asked, batch=100, progress=False
    )
    return found.ranks[:, 0]


@pytest.mark.slow
def test_exact_draws_fail_in_amplitudes_at_the_nominal_rate(retrieval):
    """400 calibrations of 20 simulations each."""

    def exact(key, posterior):
        return retrieval[0].exact(key, posterior.y, 20)[None]

    ranks = ranks_in_amplitudes(retrieval, exact, 400 * 20).reshape(400, 20)
    alarms = sum(uniformity(u) < 0.05 for u in ranks)
    print(f"\n{alarms} of 400 fail")
    least, most = scipy.stats.binom(400, 0.05).interval(0.99)
    assert least <= alarms <= most


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["the prior", "another recording"])
def test_amplitudes_catch_draws_that_forget_their_recording(fault, retrieval):
    """In 95 % of 40 repetitions of 50 simulations."""
    known, problem = retrieval

    def drawer(key, posterior):
        key, other = jax.random.split(key)
        if fault == "the prior":
            return jax.vmap(posterior.prior.sample)(jax.random.split(key, 20))[None]
        return known.exact(key, problem.simulate(other)[1], 20)[None]

    ranks = ranks_in_amplitudes(retrieval, drawer, 40 * 50).reshape(40, 50)
    caught = np.mean([uniformity(u) < 0.05 for u in ranks])
    print(f"\n{fault}: caught in {100 * caught:.0f} % of repetitions at 50 simulations")
    assert caught >= 0.95


def test_small_objects_have_what_is_there():
    assert [name for name in default_quantities(denoising((1,))) if "px" in name] == []
    assert isinstance(default_quantities(denoising((1,)))["mean [0:1]"], PatchMean)


def test_a_score_network_has_no_density_to_ask_for(x64):
    prior = ScorePrior(wiener(), (8, 6))
    problem = ps.Problem(denoising((8, 6)).likelihood, prior)
    assert not {"log-prior", "log-posterior"} & set(default_quantities(problem))
