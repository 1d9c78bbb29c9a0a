"""Every operator against its dense matrix, and against the physics written another way."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage

from posterior.models import optics as module
from posterior.models.optics import (
    Blur,
    CodedDiffraction,
    Fourier,
    FourierPtychography,
    Identity,
    Matrix,
    Optics,
    Propagation,
)


def normal(*shape, seed=0):
    return np.random.default_rng(seed).standard_normal(shape)


def complex_normal(*shape, seed=0):
    return normal(*shape, seed=seed) + 1j * normal(*shape, seed=seed + 1)


HALF = np.arange(20).reshape(4, 5) < 10
CROSS = np.zeros((3, 3), bool)
CROSS[1] = CROSS[:, 1] = True
PUPIL = np.where(module._disc((6, 4), (2, 2)), complex_normal(6, 4), 0)
PUPILS = complex_normal(4, 6, 4) * (PUPIL != 0)
# The window around (-4, 5) leaves the band of (12, 16); the disc inside it does not.
CENTRES = np.array([[0, 0], [-4, 5], [3, -6], [1, 1]])
ODD_CENTRES = np.array([[0, 0], [2, -3]])
MASKS, COMPLEX_MASKS = normal(3, 4, 5), complex_normal(2, 6)
KERNEL, FULL_PSF = normal(3, 5), normal(6, 4)
REAL_MATRIX, COMPLEX_MATRIX = normal(7, 5), complex_normal(4, 6)
WAVELENGTH = 0.5e-6

CASES = {
    "identity": lambda: Identity((4, 5)),
    "fourier": lambda: Fourier((4, 5)),
    "fourier_3d": lambda: Fourier((2, 3, 4), oversampling=2),
    "fourier_4d": lambda: Fourier((2, 3, 2, 2)),
    "fourier_oversampled": lambda: Fourier((4, 5), oversampling=3),
    "fourier_half": lambda: Fourier((4, 5), oversampling=2, support=HALF),
    "fourier_cross": lambda: Fourier((3, 3), support=CROSS),
    "ptychography": lambda: FourierPtychography((12, 16), CENTRES, PUPIL),
    "ptychography_odd": lambda: FourierPtychography((11, 13), ODD_CENTRES, complex_normal(5, 7)),
    "ptychography_pupils": lambda: FourierPtychography((12, 16), CENTRES, PUPILS),
    "ptychography_rim": lambda: FourierPtychography((12, 16), CENTRES, PUPILS, rim=(2, 1)),
    "coded": lambda: CodedDiffraction(MASKS),
    "coded_complex": lambda: CodedDiffraction(COMPLEX_MASKS),
    "propagation": lambda: Propagation((6, 8), WAVELENGTH, 0.3e-6, 4e-6),
    "propagation_1d": lambda: Propagation((9,), WAVELENGTH, 0.2e-6, -3e-6),
    "blur": lambda: Blur((6, 7), KERNEL),
    "blur_full": lambda: Blur((6, 4), FULL_PSF),
    "blur_3d": lambda: Blur((4, 3, 5), normal(3, 1, 5)),
    "matrix": lambda: Matrix(REAL_MATRIX),
    "matrix_complex": lambda: Matrix(COMPLEX_MATRIX, in_shape=(2, 3)),
}
REAL = {"identity", "blur", "blur_full", "blur_3d", "matrix"}


@pytest.fixture(params=CASES)
def name(request):
    return request.param


def draw(shape, precision, is_complex, seed=10):
    values = (complex_normal if is_complex else normal)(*shape, seed=seed)
    return jnp.asarray(values.astype(np.result_type(precision, "c8" if is_complex else "f4")))


def dense(optics):
    """H as (measurements, pixels), column by column."""
    basis = np.eye(math.prod(optics.in_shape), dtype=complex).reshape(-1, *optics.in_shape)
    return np.asarray(jax.jit(jax.vmap(optics))(basis)).reshape(len(basis), -1).T


apply = jax.jit(lambda optics, o: optics(o))
adjoint = jax.jit(lambda optics, field: optics.adjoint(field))


def tolerance(optics, precision):
    """Rounding of a transform over n numbers, for results of the order of the norms of H and o."""
    n = math.prod(optics.in_shape) + math.prod(optics.out_shape)
    scale = np.sqrt(max(float(optics.norm_squared()), 1.0))
    return 50 * np.finfo(precision).eps * np.sqrt(n) * scale


@pytest.mark.parametrize("is_complex", [False, True])
def test_adjoint(name, precision, is_complex):
    optics = CASES[name]()
    x = draw(optics.in_shape, precision, is_complex)
    y = draw(optics.out_shape, precision, is_complex, seed=20)
    hx, hy = apply(optics, x), adjoint(optics, y)
    assert hx.shape == optics.out_shape
    assert hy.shape == optics.in_shape
    x, y, hx, hy = (np.asarray(a, complex).ravel() for a in (x, y, hx, hy))
    error = abs(np.vdot(hx, y) - np.vdot(x, hy))
    assert error <= tolerance(optics, precision) * np.linalg.norm(x) * np.linalg.norm(y)


@pytest.mark.parametrize("dtype", ["float32", "float64", "complex64", "complex128"])
def test_dtype_follows_the_input(name, x64, dtype):
    optics = CASES[name]()
    assert optics.real == (name in REAL)
    expected = np.dtype(dtype) if optics.real else np.result_type(dtype, np.complex64)
    o = jax.ShapeDtypeStruct(optics.in_shape, dtype)
    field = jax.ShapeDtypeStruct(optics.out_shape, dtype)
    assert jax.eval_shape(optics, o).dtype == expected
    assert jax.eval_shape(optics.adjoint, field).dtype == expected


@pytest.mark.parametrize("dtype", ["float32", "complex64", "float64", "complex128"])
def test_strict_promotion(name, x64, dtype):
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        optics = CASES[name]()
        jax.eval_shape(optics, jax.ShapeDtypeStruct(optics.in_shape, dtype))
        jax.eval_shape(optics.adjoint, jax.ShapeDtypeStruct(optics.out_shape, dtype))
        jax.eval_shape(optics.row_norms)
        jax.eval_shape(optics.norm_squared)
        jax.eval_shape(Optics.norm_squared, optics)


def test_row_norms(name, precision):
    optics = CASES[name]()
    norms = optics.row_norms()
    assert norms.shape == optics.out_shape
    assert norms.dtype == precision
    truth = np.linalg.norm(dense(optics), axis=1).reshape(optics.out_shape)
    np.testing.assert_allclose(norms, truth, rtol=0, atol=tolerance(optics, precision))


def test_norm_squared(name, precision):
    optics = CASES[name]()
    norm = optics.norm_squared()
    assert norm.shape == ()
    assert norm.dtype == precision
    truth = np.linalg.norm(dense(optics), 2) ** 2
    if name == "ptychography_rim":
        # A rim takes light away, by which the norm is no more in closed form.
        assert truth <= norm
    else:
        np.testing.assert_allclose(norm, truth, rtol=tolerance(optics, precision))


@pytest.mark.parametrize(
    "name", ["fourier_half", "ptychography", "coded", "blur", "matrix_complex"]
)
def test_default_norm_squared_is_a_close_bound(name):
    optics = CASES[name]()
    truth = float(optics.norm_squared())
    estimate = float(jax.jit(Optics.norm_squared)(optics))
    assert truth <= estimate <= 1.1 * truth * (1 + tolerance(optics, "float32"))


def test_an_operator_of_ones_own():
    class Double(Optics):
        def _apply(self, o):
            return 2 * o

        def _adjoint(self, field):
            return 2 * field

        def row_norms(self):
            return 2 * jnp.ones(self.out_shape)

    optics = Double((3,), (3,), real=True)
    assert optics.symmetries == ("global_phase",)
    np.testing.assert_allclose(optics.norm_squared(), 4.4, rtol=1e-6)
    with pytest.raises(ValueError, match=r"object has shape \(4,\)"):
        optics(jnp.ones(4))


SYMMETRIES = {
    "global_phase": lambda o: o * np.exp(0.7j),
    "conjugate_flip": lambda o: np.conj(np.flip(o)),
    "circular_shift": lambda o: np.roll(o, [1] * o.ndim, range(o.ndim)),
}
EXPECTED_SYMMETRIES = {
    "fourier": {"conjugate_flip", "circular_shift"},
    "fourier_4d": {"conjugate_flip", "circular_shift"},
    "fourier_3d": {"conjugate_flip"},
    "fourier_oversampled": {"conjugate_flip"},
    "fourier_cross": {"conjugate_flip"},
}


def test_symmetries(name, x64):
    optics = CASES[name]()
    assert set(optics.symmetries) == {"global_phase"} | EXPECTED_SYMMETRIES.get(name, set())
    o = complex_normal(*optics.in_shape)
    before = np.abs(apply(optics, o))
    for symmetry, transform in SYMMETRIES.items():
        change = np.max(np.abs(np.abs(apply(optics, transform(o))) - before))
        limit = tolerance(optics, "float64") * np.linalg.norm(o)
        assert (change <= limit) == (symmetry in optics.symmetries), symmetry


def test_support_of_ones_is_no_support():
    assert Fourier((3, 4), support=np.ones((3, 4), bool)).symmetries == Fourier((3, 4)).symmetries


def test_jit_and_vmap(name):
    optics = CASES[name]()
    o = draw((3, *optics.in_shape), "float32", True)
    one_by_one = jnp.stack([apply(optics, x) for x in o])
    there = jax.jit(lambda h, x: jax.vmap(h)(x))(optics, o)
    back = jax.jit(lambda h, y: jax.vmap(h.adjoint)(y))(optics, there)
    atol = tolerance(optics, "float32") * float(jnp.linalg.norm(o))
    np.testing.assert_allclose(there, one_by_one, rtol=0, atol=atol)
    expected = jnp.stack([adjoint(optics, y) for y in one_by_one])
    atol *= max(1.0, float(optics.norm_squared()))
    np.testing.assert_allclose(back, expected, rtol=0, atol=atol)


def test_gradient_is_the_adjoint(name, x64):
    optics = CASES[name]()
    o = jnp.asarray(complex_normal(*optics.in_shape))
    half_norm_gradient = jax.jit(jax.grad(lambda x: jnp.sum(jnp.abs(optics(x)) ** 2) / 2))
    gradient = jnp.conj(half_norm_gradient(o))
    atol = tolerance(optics, "float64") * max(1.0, float(optics.norm_squared())) * 10
    np.testing.assert_allclose(gradient, adjoint(optics, apply(optics, o)), rtol=0, atol=atol)


SAME_SHAPES = {
    "centres": lambda i: FourierPtychography((12, 16), CENTRES * (1 - i), PUPIL),
    "pupil": lambda i: FourierPtychography((12, 16), CENTRES, PUPIL * (1 + i)),
    "masks": lambda i: CodedDiffraction(MASKS + i),
    "psf": lambda i: Blur((6, 7), KERNEL + i),
    "distance": lambda i: Propagation((6, 8), WAVELENGTH, 0.3e-6, i * 1e-6),
    "matrix": lambda i: Matrix(REAL_MATRIX + i),
}


@pytest.mark.parametrize("which", SAME_SHAPES)
def test_new_values_do_not_recompile(which):
    traces = []

    @jax.jit
    def counted(optics, o):
        traces.append(which)
        return optics(o)

    first, second = (SAME_SHAPES[which](i) for i in (0, 1))
    o = draw(first.in_shape, "float32", True)
    before, after = counted(first, o), counted(second, o)
    assert len(traces) == 1
    atol = tolerance(second, "float32") * float(jnp.linalg.norm(o))
    np.testing.assert_allclose(after, second(o), rtol=0, atol=atol)
    assert np.max(np.abs(after - before)) > atol


def dft(n_in, n_out):
    """(n_out, n_in) unitary DFT of an axis padded at its end."""
    return np.exp(-2j * np.pi * np.outer(np.arange(n_out), np.arange(n_in)) / n_out) / n_out**0.5


@pytest.mark.parametrize("oversampling", [1, 2, 3])
def test_fourier_is_the_dft(x64, oversampling):
    o, support = complex_normal(4, 5), HALF
    left, right = dft(4, 4 * oversampling), dft(5, 5 * oversampling)
    field = Fourier((4, 5), oversampling)(o)
    np.testing.assert_allclose(field, left @ o @ right.T, atol=1e-13)
    field = Fourier((4, 5), oversampling, support)(o)
    np.testing.assert_allclose(field, left @ (o * support) @ right.T, atol=1e-13)


def ptychography_by_rolling(o, centres, pupil):
    """The same fields with no crop: roll the spectrum, and read the low frequencies by name."""
    rows, columns = (np.rint(np.fft.fftfreq(n) * n).astype(int) for n in pupil.shape[-2:])
    fields = []
    each = np.broadcast_to(pupil, (len(centres), *pupil.shape[-2:]))
    for (row, column), pupil in zip(centres, each):
        spectrum = np.roll(np.fft.fft2(o), (-row, -column), (0, 1))
        low = spectrum[np.ix_(rows % o.shape[0], columns % o.shape[1])]
        fields.append(np.fft.ifft2(low * np.fft.ifftshift(pupil)) * pupil.size / o.size)
    return np.array(fields)


@pytest.mark.parametrize("name", [name for name in CASES if name.startswith("ptychography")])
def test_ptychography_against_a_loop(x64, name):
    optics = CASES[name]()
    o = complex_normal(*optics.in_shape)
    expected = ptychography_by_rolling(o, np.asarray(optics.centres), np.asarray(optics.pupil))
    (_, rows, columns), (top, left) = expected.shape, optics.rim
    expected = expected[:, top : rows - top, left : columns - left]
    np.testing.assert_allclose(optics(o), expected, atol=1e-13)


def test_frequencies_that_reach_the_camera():
    """Two pupils of 2x2 and 3x1 samples, one of which they share."""
    pupils = np.zeros((2, 4, 4))
    pupils[0, 1:3, 1:3] = 1
    pupils[1, 2, 1:] = 1
    optics = FourierPtychography((16, 16), [[0, 0], [0, 1]], pupils)
    assert optics.frequencies() == 4 + 3 - 1
    assert FourierPtychography((16, 16), [[0, 0], [0, 5]], pupils).frequencies() == 7


def test_the_field_of_view_is_what_the_rim_surrounds():
    optics = FourierPtychography((24, 32), [[0, 0]], np.ones((8, 8)), rim=(1, 2))
    assert optics.field_of_view == (slice(3, 21), slice(8, 24))
    assert optics.out_shape == (1, 6, 4)


@pytest.mark.parametrize("centre", [(0, 0), (3, -5)])
def test_a_plane_wave_keeps_its_amplitude(precision, centre):
    """On the axis of its own LED a plane wave is seen flat, with unit amplitude."""
    optics = FourierPtychography.from_radius((16, 24), [centre], 2.0, upsampling=2)
    rows, columns = np.indices((16, 24))
    o = np.exp(2j * np.pi * (centre[0] * rows / 16 + centre[1] * columns / 24))
    field = optics(o.astype(np.result_type(precision, np.complex64)))
    np.testing.assert_allclose(field, np.ones((1, 8, 12)), atol=100 * np.finfo(precision).eps)


MICROSCOPE = {
    "upsampling": 4,
    "na": 0.25,
    "wavelength": 0.5e-6,
    "pixel_size": 0.8e-6,
    "led_na": [[0.0, 0.0], [0.1, -0.2]],
}


def test_microscope():
    """16 x 32 camera pixels of 0.8 um: Fourier samples of na 1/25.6 and 1/51.2."""
    optics = FourierPtychography.from_microscope((64, 128), **MICROSCOPE)
    assert optics.out_shape == (2, 16, 32)
    np.testing.assert_array_equal(optics.centres, [[0, 0], [3, -10]])
    rows, columns = np.indices((16, 32))
    inside = np.hypot((rows - 8) / 25.6, (columns - 16) / 51.2) <= 0.25
    np.testing.assert_array_equal(optics.pupil, inside)


def test_microscope_from_positions():
    """At 80 mm, LEDs 4 mm apart: sine 0.1 lies at 0.1 / sqrt(1 - 0.01 - 0.04) x 80 mm."""
    across = 0.08 / np.sqrt(1 - 0.01 - 0.04)
    positions = {"led_positions": [[0, 0], [0.1 * across, -0.2 * across]], "led_height": 0.08}
    settings = {k: v for k, v in MICROSCOPE.items() if k != "led_na"}
    optics = FourierPtychography.from_microscope((64, 128), **settings, **positions)
    np.testing.assert_array_equal(optics.centres, [[0, 0], [3, -10]])


def test_aberration_is_the_phase_of_the_pupil():
    phase = normal(16, 32)
    plain = FourierPtychography.from_microscope((64, 128), **MICROSCOPE)
    optics = FourierPtychography.from_microscope((64, 128), **MICROSCOPE, aberration=phase)
    np.testing.assert_allclose(optics.pupil, plain.pupil * np.exp(1j * phase), atol=1e-6)


def test_coded_diffraction_is_masked_far_field(x64):
    o = complex_normal(4, 5)
    expected = [dft(4, 4) @ (mask * o) @ dft(5, 5).T for mask in MASKS]
    np.testing.assert_allclose(CodedDiffraction(MASKS)(o), expected, atol=1e-13)


def test_propagating_back_undoes_it(precision):
    """Pixels of 0.3 um at 0.5 um: what the first pass drops stays dropped, the rest returns."""
    there = Propagation((16, 12), WAVELENGTH, 0.3e-6, 50e-6)
    back = Propagation((16, 12), WAVELENGTH, 0.3e-6, -50e-6)
    o = draw((16, 12), precision, True)
    band_limited = Propagation((16, 12), WAVELENGTH, 0.3e-6, 0.0)(o)
    assert not np.allclose(band_limited, o, atol=1e-3)
    atol = tolerance(there, precision) * float(jnp.linalg.norm(o))
    np.testing.assert_allclose(back(there(band_limited)), band_limited, rtol=0, atol=atol)


@pytest.mark.parametrize("cycles", [(0, 0), (3, -2), (0, 7)])
def test_a_plane_wave_gains_its_phase(precision, cycles):
    shape, pixel, distance = (16, 20), 0.4e-6, 123e-6
    turns = sum(c * x / n for c, x, n in zip(cycles, np.indices(shape), shape))
    wave = np.exp(2j * np.pi * turns)
    f2 = sum((c / (n * pixel)) ** 2 for c, n in zip(cycles, shape))
    expected = wave * np.exp(2j * np.pi * distance * np.sqrt(WAVELENGTH**-2 - f2))
    optics = Propagation(shape, WAVELENGTH, pixel, distance)
    field = optics(wave.astype(np.result_type(precision, np.complex64)))
    atol = 50 * np.finfo(precision).eps * np.sqrt(wave.size)
    # The phase is 123 um / 0.5 um turns in double precision, whatever JAX's.
    atol += 2 * np.pi * distance / WAVELENGTH * np.finfo("float64").eps
    np.testing.assert_allclose(field, expected, rtol=0, atol=atol)


def test_a_gaussian_beam_spreads(x64):
    """w(z) = w0 sqrt(1 + (z / z_R)^2), up to the square of the divergence angle (Goodman 3.10)."""
    n, pixel, waist = 128, 1e-6, 8e-6
    rayleigh = np.pi * waist**2 / WAVELENGTH
    x = (np.arange(n) - n // 2) * pixel
    beam = np.exp(-np.add.outer(x**2, x**2) / waist**2).astype(complex)
    field = Propagation((n, n), WAVELENGTH, pixel, rayleigh)(beam)
    intensity = np.abs(field) ** 2
    width = 2 * np.sqrt(np.sum(intensity * x**2) / np.sum(intensity))
    divergence = WAVELENGTH / (np.pi * waist)
    np.testing.assert_allclose(width, waist * np.sqrt(2), rtol=2 * divergence**2)


@pytest.mark.parametrize(
    ("shape", "kernel"), [((6, 7), (3, 5)), ((6, 4), (6, 4)), ((8,), (8,)), ((5, 6, 4), (3, 1, 3))]
)
def test_blur_is_wrapped_convolution(x64, shape, kernel):
    psf, o = normal(*kernel), normal(*shape)
    expected = scipy.ndimage.convolve(o, psf, mode="wrap")
    np.testing.assert_allclose(Blur(shape, psf)(o), expected, atol=1e-13)
    twice = Blur(shape, psf)(o + 2j * o)
    np.testing.assert_allclose(twice, expected * (1 + 2j), atol=1e-13)


def microscope(**changes):
    return FourierPtychography.from_microscope((64, 128), **(MICROSCOPE | changes))


def ptychography(centres=CENTRES, pupil=PUPIL, shape=(12, 16), rim=(0, 0)):
    return FourierPtychography(shape, centres, pupil, rim)


NAN_PSF = np.array([1.0, np.nan, 1.0])
BAD = [
    (lambda: Identity((4, 0)), r"\(4, 0\)"),
    (lambda: Identity(4), "got 4"),
    (lambda: Identity((2.5,)), r"2\.5"),
    (lambda: Identity(()), r"got \(\)"),
    (lambda: Fourier((4,), oversampling=0), "oversampling .* got 0"),
    (lambda: Fourier((4,), oversampling=1.5), r"oversampling .* got 1\.5"),
    (lambda: Fourier((4,), oversampling=True), "oversampling .* got True"),
    (lambda: Fourier((4,), support=np.ones(3, bool)), r"\(3,\)"),
    (lambda: Fourier((4,), support=np.ones(4)), "float64"),
    (lambda: Fourier((4,), support=np.zeros(4, bool)), "False everywhere"),
    (lambda: ptychography(shape=(12,)), r"\(12,\)"),
    (lambda: ptychography(centres=[[0, 0, 0]]), r"\(1, 3\)"),
    (lambda: ptychography(centres=np.zeros((0, 2), int)), r"\(0, 2\)"),
    (lambda: ptychography(centres=[[0.5, 1.0]]), r"\[0\.5, 1\.0\]"),
    (lambda: ptychography(centres=[[0, 0], [5, 0]]), r"centre \(5, 0\) .* at least \(15, 16\)"),
    (lambda: ptychography(centres=[[0, 0], [0, -7]]), r"centre \(0, -7\) .* at least \(12, 18\)"),
    (lambda: ptychography(pupil=np.ones(4)), r"\(4,\)"),
    (lambda: ptychography(pupil=np.zeros((4, 4))), "0 everywhere"),
    (lambda: ptychography(pupil=np.full((4, 4), np.inf)), r"inf at \(0, 0\)"),
    (lambda: ptychography(pupil=[["a", "b"]]), "dtype <U1"),
    (lambda: ptychography(rim=(0, 2)), r"rim \(0, 2\) leaves nothing of \(6, 4\)"),
    (lambda: ptychography(rim=(-1, 0)), r"rim \(-1, 0\): give two whole numbers"),
    (lambda: ptychography(rim=(1,)), r"rim \(1,\): give two whole numbers"),
    (lambda: FourierPtychography.from_radius((8, 8), [[0, 0]], 3.0, 2), "radius 3.0 .* most 2.0"),
    (lambda: FourierPtychography.from_radius((8, 8), [[0, 0]], -1, 2), "radius .* got -1"),
    (lambda: FourierPtychography.from_radius((8, 9), [[0, 0]], 1, 2), r"2 must divide .*\(8, 9\)"),
    (lambda: FourierPtychography.from_radius((8, 8), [[9, 0]], 1, 2), r"centre \(9, 0\)"),
    (
        lambda: FourierPtychography.from_radius((8, 8), [[0, 0], [1, 0], [0, 0]], 1, 2),
        "LEDs 0 and 2 are in the same direction: add their images up",
    ),
    (lambda: microscope(led_na=[[0.1, 0.0], [0.1, 0.0]]), "LEDs 0 and 1 are in the same"),
    (lambda: microscope(upsampling=0), "upsampling .* got 0"),
    (lambda: microscope(na=0.0), r"na .* got 0\.0"),
    (lambda: microscope(na=1.6), r"na .* got 1\.6"),
    (lambda: microscope(na="0.1 water"), "na .* got 0.1 water"),
    (lambda: microscope(wavelength=-0.5e-6), "wavelength .* got -5e-07"),
    (lambda: microscope(pixel_size=0.0), r"pixel_size .* got 0\.0"),
    (lambda: microscope(pixel_size=1.1e-6), "1.1e-06 m .* at most 1e-06 m"),
    (
        lambda: microscope(led_na=[[0.0, 1.2]]),
        r"upsampling 4; use upsampling 5 \(shape \(80, 160\)",
    ),
    (lambda: microscope(led_na=[[0.0, 30.0]]), r"\(0\.0, 30\.0\)"),
    (lambda: microscope(led_na=[[0.0, np.nan]]), "nan"),
    (lambda: microscope(led_na=[0.0, 0.1]), r"\(2,\)"),
    (lambda: microscope(led_na=None), r"got \[\]"),
    (lambda: microscope(led_height=0.1), "led_height"),
    (lambda: microscope(led_na=None, led_positions=[[0, 0]]), r"got \['led_positions'\]"),
    (
        lambda: microscope(led_na=None, led_positions=[[0, 0]], led_height=-0.1),
        r"led_height .* got -0\.1",
    ),
    (lambda: microscope(aberration=np.zeros((2, 2))), r"\(16, 32\), got \(2, 2\)"),
    (lambda: microscope(aberration=np.zeros((16, 32), complex)), "complex128"),
    (lambda: CodedDiffraction(np.ones(3)), r"\(3,\)"),
    (lambda: CodedDiffraction(np.zeros((3, 3))), r"\(3, 3\) is 0 everywhere"),
    (lambda: Propagation((4, 4, 4), 1.0, 1.0, 1.0), r"\(4, 4, 4\)"),
    (lambda: Propagation((4, 4), 0.0, 1.0, 1.0), r"wavelength .* got 0\.0"),
    (lambda: Propagation((4, 4), 1.0, -2.0, 1.0), r"pixel_size .* got -2\.0"),
    (lambda: Propagation((4, 4), 1.0, 1.0, np.inf), "distance .* got inf"),
    (lambda: Propagation((4, 4), 1.0, 1.0, None), "distance .* got None"),
    (lambda: Blur((4,), np.ones(2)), r"\(2,\)"),
    (lambda: Blur((4,), np.ones(5)), r"\(5,\)"),
    (lambda: Blur((4,), np.ones((3, 3))), r"\(3, 3\)"),
    (lambda: Blur((4,), 1j * np.ones(3)), "complex128"),
    (lambda: Blur((4,), NAN_PSF), r"nan at \(1,\)"),
    (lambda: Matrix(np.ones(3)), r"\(3,\)"),
    (lambda: Matrix(np.ones((3, 4)), in_shape=(2, 3)), r"\(2, 3\) holds 6 .* takes 4"),
    (lambda: Matrix(np.full((1, 2), np.nan)), r"nan at \(0, 0\)"),
]


@pytest.mark.parametrize(("build", "message"), BAD)
def test_bad_input_is_refused_by_value(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_wrong_shapes_and_dtypes_are_refused(name):
    optics = CASES[name]()
    with pytest.raises(ValueError, match=r"object has shape \(2, 99\).*reshape"):
        optics(np.ones((2, 99)))
    with pytest.raises(ValueError, match=r"field has shape \(2, 99\).*reshape"):
        optics.adjoint(np.ones((2, 99)))
    with pytest.raises(ValueError, match="int32; convert"):
        optics(jnp.ones(optics.in_shape, jnp.int32))
