# %% [markdown]
# # Train a prior on your own pictures
#
# A prior says which pictures are likely before anything was recorded. The most telling one is
# learnt from pictures like those you expect. This notebook trains a small network for five minutes
# on a laptop, from pictures that come with scikit-image, and denoises one that it never saw.
#
# On your own folder the same is one command, which can be stopped and goes on where it was:
#
# ```sh
# posterior train --data my_pictures --perturbation poisson --out mine
# ```

# %%
import jax
import matplotlib.pyplot as plt
import numpy as np
import skimage
from skimage.restoration import denoise_tv_chambolle

import posterior as ps
from posterior import models, samplers
from posterior.estimators import anscombe_denoised
from posterior.models.priors.denoiser import Denoiser
from posterior.models.priors.storage import build_network
from posterior.models.priors.training import Recipe
from posterior.train import Preparation, statistics_of, train

# %% [markdown]
# ## Pictures
#
# Grey, from 0 to 1, each an array (height, width, 1). Keep some apart: what a network does with
# pictures it was trained on says nothing.

# %%
NAMES = ("astronaut", "brick", "cell", "chelsea", "coffee", "coins", "grass", "moon", "rocket")


def grey(name):
    """A picture of scikit-image at half its size, (h, w)."""
    picture = getattr(skimage.data, name)() / 255
    picture = skimage.color.rgb2gray(picture) if picture.ndim == 3 else picture
    return skimage.transform.rescale(picture, 0.5, anti_aliasing=True).astype(np.float32)


pictures = [np.clip(grey(name), 0, 1)[..., None] for name in NAMES]
held_out = np.clip(grey("camera"), 0, 1)[20:84, 80:144]
print(f"{len(pictures)} pictures, {sum(p.size for p in pictures)} pixels")

# %% [markdown]
# ## What the network learns
#
# Cut a patch, record it with a camera of random exposure, and ask for the patch back. The answer
# with the least squared error is the mean of all patches that could have been recorded so:
# `E[object | counts]`, at every exposure. Nothing else is needed to draw from the posterior, as the
# next notebook shows.
#
# For other noise than that of counting, `perturbation="gaussian"` learns the same of pictures under
# Gaussian noise, whose score serves every other sampler.

# %%
statistics = statistics_of(pictures, "poisson", Preparation())
network = build_network(
    {"type": "unet", "channels": 1, "widths": [24, 48], "blocks": 1}, jax.random.key(0)
)
recipe = Recipe(steps=1500, batch=16, size=32)
denoiser, losses, seconds = train(Denoiser(network, statistics), pictures, recipe)
print(f"{seconds:.0f} s; loss {losses[:100].mean():.3f}, then {losses[-300:].mean():.3f}")

# %% [markdown]
# The loss is in units in which a network that has learnt nothing has about 1 at every exposure.
#
# ## Is it any good?
#
# Against total variation, a classical denoiser, whose one parameter we choose by looking at the
# truth: an advantage that the network does not get.

# %%
prior = models.ScorePrior(denoiser, held_out.shape)
camera = models.Poisson(full_well=100)
y = np.asarray(camera.sample(jax.random.key(1), held_out))


def psnr(picture):
    """Decibels below full well at which the error lies."""
    return float(-10 * np.log10(np.mean((picture - held_out) ** 2)))


def smoothed(share):
    """Total variation on the square roots of the counts, where noise is uniform."""
    return anscombe_denoised(
        y, camera, lambda root, sd: denoise_tv_chambolle(root, weight=share * sd)
    )


classical = max((smoothed(share) for share in (0.5, 0.75, 1, 1.5, 2)), key=psnr)
learnt = np.asarray(jax.jit(lambda y: prior.denoise(y, camera.sigma0))(y))
print(f"{psnr(y):.1f} dB; total variation {psnr(classical):.1f}, network {psnr(learnt):.1f}")

# %% [markdown]
# ## Use it
#
# As any other prior: a likelihood, a recording, a sampler.

# %%
likelihood = models.LinearLikelihood(models.Identity(held_out.shape), camera)
draws = ps.sample(
    ps.Problem(likelihood, prior).condition(y),
    samplers.Thickening(),
    jax.random.key(2),
    chains=19,
    draws=1,
    progress=False,
).values[:, 0]
held = np.mean((draws.min(0) < held_out) & (held_out < draws.max(0)))
print(f"mean of draws {psnr(draws.mean(0)):.1f} dB; 90 % intervals hold {100 * held:.0f} %")

panels = {
    "truth": held_out,
    "recording": y,
    "a draw": draws[0],
    "mean": draws.mean(0),
    "standard deviation x 8": 8 * draws.std(0, ddof=1),
}
figure, axes = plt.subplots(1, 5, figsize=(12, 2.8), layout="constrained")
for ax, (title, image) in zip(axes, panels.items()):
    ax.imshow(image, cmap="gray", vmin=0, vmax=1)
    ax.set_title(title)
    ax.set_axis_off()
figure.savefig("02_denoised.png", dpi=120)

# %% [markdown]
# ## What five minutes do not buy
#
# Draws of the prior alone, from no recording at all, show what the network believes pictures to
# be: smooth patches, textures, edges, and nothing that you could name. It is a prior for the small
# scale.
# Where a recording says little, that is not enough; train longer, on more pictures, of what you
# look at.

# %%
keys = jax.random.split(jax.random.key(3), 5)
imagined = models.ScorePrior(denoiser, held_out.shape, sampling_steps=150)
figure, axes = plt.subplots(1, 5, figsize=(12, 2.8), layout="constrained")
for ax, picture in zip(axes, np.asarray(jax.jit(jax.vmap(imagined.sample))(keys))):
    ax.imshow(picture, cmap="gray", vmin=0, vmax=1)
    ax.set_axis_off()
figure.savefig("02_imagined.png", dpi=120)

# %% [markdown]
# ## What this notebook claims
#
# If one of these lines fails, the text above is wrong.

# %%
assert losses[-300:].mean() < losses[:100].mean()
assert psnr(learnt) > psnr(classical)
assert psnr(draws.mean(0)) > psnr(learnt) - 0.5
assert held > 0.7
