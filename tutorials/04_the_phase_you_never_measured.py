# %% [markdown]
# # The phase you never measured
#
# A thin, clear specimen changes the brightness of the light a little and delays it. The delay, its
# **phase**, is what tells one part of a cell from another, and no camera records it: a pixel counts
# photons, and photons do not say when.
#
# **Fourier ptychography** gets at it by another way. Light the specimen from many directions, one
# LED at a time. Each shifts another part of the specimen's spectrum into the small window that the
# lens lets through. Neighbouring windows overlap, and that all the pictures come from one complex
# object leaves little choice of its phase. How little, we shall see.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import skimage

import posterior as ps
from posterior import diagnostics, models, presets
from posterior.estimators import default_start, maximum_likelihood

SIDE = 64

# %% [markdown]
# ## A specimen
#
# From a picture of a cell: its grey values give the amplitude, those of its mirror image the phase,
# so that the two have nothing to do with each other.

# %%
cell = skimage.data.cell() / 255
grey = skimage.transform.resize(cell[210:530, 230:550], (SIDE, SIDE), anti_aliasing=True)
grey = (grey - grey.min()) / np.ptp(grey)
specimen = jnp.asarray(presets.complex_object(grey), complex)

# %% [markdown]
# ## Forty-nine pictures
#
# A 7 x 7 grid of LEDs. Each picture has a sixteenth of the specimen's pixels: the lens is a small
# one, and sees a wide field. Light is scarce: a pixel holds at most 100 electrons, and an 8-bit ADC
# reads them.

# %%
centres, radius = presets.aperture_grid(SIDE)
optics = models.FourierPtychography.from_radius((SIDE, SIDE), centres, radius, 4)
camera = models.Poisson(full_well=100, bits=8)
brightest = float(jnp.max(jnp.abs(optics(specimen)) ** 2))
likelihood = models.IntensityLikelihood(optics, camera, 0.9 / brightest)
y = np.asarray(likelihood.simulate(jax.random.key(0), specimen))
print(f"{len(y)} pictures of {y.shape[1]}x{y.shape[2]}; {(y.mean((1, 2)) < 0.05).sum()} are dark")

# %% [markdown]
# ## One answer
#
# The classical one: the object of highest likelihood, by a quasi-Newton method from the picture of
# the middle LED. It explains the recordings as well as anything can, their noise included.
#
# Turning the phase of the whole object changes no picture. Before two objects are compared they are
# turned to each other; the likelihood cannot tell, and neither should we.

# %%


def turned(objects):
    """Objects (..., 64, 64), each brought to the global phase of the specimen."""
    return diagnostics.align(np.asarray(objects), np.asarray(specimen), ["global_phase"])


def errors(found):
    """PSNR in dB of amplitude (peak 1) and phase (peak 2 pi)."""
    amplitude = np.abs(found) - np.abs(specimen)
    phase = np.angle(found * specimen.conj()) / (2 * np.pi)
    return tuple(float(-10 * np.log10(np.mean(e**2))) for e in (amplitude, phase))


best = turned(maximum_likelihood(likelihood, y, default_start(likelihood, y)).object)
print("highest likelihood: amplitude {:.1f} dB, phase {:.1f} dB".format(*errors(best)))

# %% [markdown]
# ## Many answers
#
# A prior of complex objects, a network trained on others than this one, and annealed Langevin
# sampling: each draw begins at the quasi-Newton answer under heavy noise and comes down through 60
# levels of it, led by the recordings and by the network.

# %%
prior = models.ScorePrior.load("complex-cells", (SIDE, SIDE), dtype=complex)
posterior = ps.Problem(likelihood, prior).condition(y)
draws = ps.sample(
    posterior,
    presets.learned_annealing(posterior),
    jax.random.key(2),
    chains=12,
    draws=1,
    start=presets.start_of("annealed", posterior, jax.random.key(1), 12),
    progress=False,
)
found = turned(draws.values[:, 0])
mean = found.mean(0)
print("mean of 12 draws: amplitude {:.1f} dB, phase {:.1f} dB".format(*errors(mean)))

# %% [markdown]
# The prior makes both better. How much depends on what the data leave open: with ten times the
# light the recordings tell the phase so well by themselves that the prior adds nothing to it.
#
# The spread of a phase is that of an angle: circular, and largest where there is little light to
# carry it.

# %%
phase_sd = diagnostics.circular_sd(np.angle(found)[None])
panels = {
    "amplitude: specimen": (np.abs(specimen), "gray", (0, 1.1)),
    "highest likelihood": (np.abs(best), "gray", (0, 1.1)),
    "mean of draws": (np.abs(mean), "gray", (0, 1.1)),
    "standard deviation": (np.abs(found).std(0, ddof=1), "magma", (0, 0.08)),
    "phase: specimen": (np.angle(specimen), "twilight", (-1.2, 1.2)),
    "highest likelihood ": (np.angle(best), "twilight", (-1.2, 1.2)),
    "mean of draws ": (np.angle(mean), "twilight", (-1.2, 1.2)),
    "standard deviation ": (phase_sd, "magma", (0, 0.2)),
}
figure, axes = plt.subplots(2, 4, figsize=(11, 5.8), layout="constrained")
for ax, (title, (image, colours, (low, high))) in zip(axes.flat, panels.items()):
    shown = ax.imshow(image, cmap=colours, vmin=low, vmax=high)
    ax.set_title(title.strip())
    ax.set_axis_off()
    figure.colorbar(shown, ax=ax, location="bottom", shrink=0.8)
figure.savefig("04_amplitude_and_phase.png", dpi=120)

# %% [markdown]
# ## Is the spread true?
#
# Compare it with the error that it should predict. Were draws and specimen of one distribution, the
# mean of the draws would be as far from the specimen as the draws are from it, and the ratio of the
# two would be 1.

# %%
ratio = diagnostics.spread_over_error(found[None], np.asarray(specimen)[None])
print(f"spread over error: {ratio:.2f}")

# %% [markdown]
# It is below 1: the draws agree with each other a little more than with the specimen. The network
# was trained on few objects, and this is none of them; it is surer than it has a right to be. On an
# object from other optics the ratio can be far lower. Knowing that is what the comparison is for.

# %% [markdown]
# ## What this notebook claims
#
# If one of these lines fails, the text above is wrong.

# %%
assert errors(mean)[0] > errors(best)[0]
assert errors(mean)[1] > errors(best)[1]
assert 0.5 < ratio < 1
