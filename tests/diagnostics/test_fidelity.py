"""Fidelity, beside closed forms and plain sums."""

import numpy as np
import pytest
import scipy.signal
import scoringrules

from posterior.diagnostics import (
    crps,
    energy_score,
    frechet_distance,
    nrmse,
    phase_psnr,
    psnr,
    ssim,
)

RNG = np.random.default_rng(0)
TRUTH = RNG.random((16, 12))
LOST = np.where(TRUTH[0, 0] == TRUTH, np.nan, TRUTH)


def test_psnr_and_nrmse_of_a_known_error():
    assert psnr(TRUTH + 0.1, TRUTH) == pytest.approx(20)
    assert psnr(TRUTH + 0.1j, TRUTH + 0j, peak=10) == pytest.approx(40)
    assert psnr(TRUTH, TRUTH) == np.inf
    assert nrmse(1.3 * TRUTH, TRUTH) == pytest.approx(0.3)
    codes = np.zeros(4, np.uint8), np.full(4, 1, np.uint8)
    assert psnr(*codes) == pytest.approx(0) and nrmse(*codes) == pytest.approx(1)


@pytest.mark.parametrize("spread", [0.2, 1.5, 3.0])
def test_phase_psnr_finds_the_best_offset(spread):
    """As a search over all offsets does, for phases on both sides of the cut and all around."""
    error = 2.9 + spread * RNG.standard_normal(200)
    truth = (0.5 + RNG.random(200)) * np.exp(1j * RNG.uniform(-np.pi, np.pi, 200))
    offsets = np.linspace(-np.pi, np.pi, 20_001)[:, None]
    wrapped = np.angle(np.exp(1j * (error - offsets)))
    expected = 10 * np.log10((2 * np.pi) ** 2 / np.mean(wrapped**2, axis=1).min())
    assert phase_psnr(2 * truth * np.exp(1j * error), truth) == pytest.approx(expected, abs=1e-5)


def test_phase_psnr_is_blind_to_a_global_phase_alone():
    truth = TRUTH * np.exp(1j * TRUTH)
    assert phase_psnr(truth * np.exp(2j), truth) > 250
    half = np.where(np.arange(12) < 6, 1, np.exp(0.4j))
    assert phase_psnr(truth * half, truth) == pytest.approx(10 * np.log10((2 * np.pi / 0.2) ** 2))


def test_ssim_is_one_for_equals_and_falls_with_noise():
    noisy = [TRUTH + sd * RNG.standard_normal(TRUTH.shape) for sd in (0.05, 0.2)]
    assert ssim(TRUTH, TRUTH) == 1
    assert 1 > ssim(noisy[0], TRUTH) > ssim(noisy[1], TRUTH)
    colour = np.stack([TRUTH] * 3, axis=-1)
    assert ssim(colour, colour) == 1


def test_ssim_is_the_published_formula():
    """Weights of 11 x 11 at every place that holds them whole, written out."""
    weights = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    weights = np.outer(weights, weights) / weights.sum() ** 2

    def mean(x):
        return scipy.signal.convolve2d(x, weights, "valid")

    x, y = TRUTH, TRUTH + 0.2 * RNG.standard_normal(TRUTH.shape)
    peak = 2.0
    c1, c2 = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    mx, my = mean(x), mean(y)
    vx, vy, both = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    alike = (2 * mx * my + c1) * (2 * both + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
    assert ssim(y, x, peak) == pytest.approx(alike.mean(), rel=1e-9)


def test_crps_is_that_of_the_normal_distribution():
    """Of many draws of N(0, 1): the closed form (Gneiting and Raftery 2007), within its error."""
    truths = np.array([-1.0, 0.0, 2.5])
    draws = RNG.standard_normal((400, 200, 3))
    found = np.stack([crps(d, truths) for d in draws])
    expected = scoringrules.crps_normal(truths, 0.0, 1.0)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert np.all(np.abs(found.mean(axis=0) - expected) < 4 * error)


def test_crps_of_few_draws_is_unbiased_and_least_for_the_truth():
    truths = RNG.standard_normal(20_000)
    score = {
        sd: crps(sd * RNG.standard_normal((4, 20_000)), truths).mean() for sd in (0.7, 1.0, 1.4)
    }
    assert score[1.0] < min(score[0.7], score[1.4])
    assert score[1.0] == pytest.approx(1 / np.sqrt(np.pi), rel=0.03)


def test_energy_score_is_the_plain_sum():
    truth = TRUTH[0] + 1j * TRUTH[1]
    draws = truth + RNG.standard_normal((5, 12)) + 1j * RNG.standard_normal((5, 12))
    near = np.mean([np.linalg.norm(d - truth) for d in draws])
    among = sum(np.linalg.norm(a - b) for a in draws for b in draws) / (5 * 4)
    assert energy_score(draws, truth) == pytest.approx(near - among / 2)
    assert energy_score(draws, truth) == pytest.approx(
        scoringrules.es_ensemble(
            np.append(truth.real, truth.imag),
            np.concatenate([draws.real, draws.imag], axis=1),
            estimator="fair",
        )
    )
    one = energy_score(draws.real[:, :1], truth.real[:1])
    assert one == pytest.approx(crps(draws.real[:, :1], truth.real[:1])[0])


def test_frechet_distance_of_normal_sets():
    x = RNG.standard_normal((500, 3))
    x = (x - x.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(x.T))).T
    assert frechet_distance(x, x) == pytest.approx(0, abs=1e-9)
    assert frechet_distance(x, 2 * x + [3, 0, 4]) == pytest.approx(25 + 3, rel=1e-6)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: psnr(TRUTH, TRUTH.T), "give one size"),
        (lambda: psnr(TRUTH[:0], TRUTH[:0]), "give one size"),
        (lambda: psnr(TRUTH + 0j, TRUTH), "complex128 beside a truth of float64"),
        (lambda: nrmse(TRUTH, TRUTH + 0j), "float64 beside a truth of complex128"),
        (lambda: psnr(LOST, TRUTH), "1 of 192 values of the object found"),
        (lambda: nrmse(TRUTH, LOST), "1 of 192 values of the truth"),
        (lambda: ssim(LOST, TRUTH), "1 of 192 values"),
        (lambda: phase_psnr(LOST + 0j, TRUTH + 0j), "1 of 192 values"),
        (lambda: psnr(TRUTH, TRUTH, 0), "peak 0: give the range"),
        (lambda: ssim(TRUTH, TRUTH, -1.0), "peak -1.0"),
        (lambda: nrmse(TRUTH, 0 * TRUTH), "the truth is 0 everywhere"),
        (lambda: phase_psnr(TRUTH + 0j, 0j * TRUTH), "the truth is 0 everywhere"),
        (lambda: phase_psnr(0j * TRUTH, TRUTH + 0j), "the object found is 0 everywhere"),
        (lambda: ssim(TRUTH[:10], TRUTH[:10]), "h and w 11 or more"),
        (lambda: ssim(TRUTH[0], TRUTH[0]), "h and w 11 or more"),
        (lambda: phase_psnr(TRUTH, TRUTH), "no phase"),
        (lambda: ssim(TRUTH + 0j, TRUTH), "real pictures"),
        (lambda: crps(TRUTH[None], TRUTH), "2 draws or more"),
        (lambda: crps(TRUTH, TRUTH), "2 draws or more"),
        (lambda: crps(np.stack([TRUTH + 0j] * 3), TRUTH), "complex draws"),
        (lambda: crps(np.stack([TRUTH, LOST]), TRUTH), "1 of 384 values of the draws"),
        (lambda: crps(np.stack([TRUTH, TRUTH]), LOST), "1 of 192 values of the truth"),
        (lambda: energy_score(np.stack([TRUTH, LOST]), TRUTH), "1 of 384 values of the draws"),
        (lambda: energy_score(np.stack([TRUTH, TRUTH]) + 0j, TRUTH), "complex128 beside"),
        (lambda: frechet_distance(TRUTH, TRUTH.T), "give .n, d."),
        (lambda: frechet_distance(TRUTH, TRUTH + 0j), "complex others"),
        (lambda: frechet_distance(TRUTH, LOST), "1 of 192 values of the features"),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
