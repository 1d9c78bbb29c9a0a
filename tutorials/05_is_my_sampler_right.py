# %% [markdown]
# # Is my sampler right?
#
# You have written a sampler. Its draws look like objects, its chains mix, its error bars have a
# plausible length. Is it right? On one data set you cannot tell. On many you can: draw an object
# from the prior, record it, draw from the posterior of that recording. If the sampler is right, the
# true object is **one more draw** among its own, and its rank among them is as likely to be first
# as last. This is simulation-based calibration.
#
# Here is a sampler of ten lines with a mistake in it. We let it be found.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

from posterior import diagnostics
from posterior.models.gallery import GALLERY

# %% [markdown]
# ## Ten lines
#
# Langevin dynamics: a step up the score, and noise. Twenty chains, of which only the last object
# counts, so that draws are independent. The signature is all that `certify` asks for: a key and a
# posterior go in, draws (chains, draws, *shape) come out.


# %%
def langevin(step, noise, steps=1500, chains=20):
    def sampler(key, posterior):
        def move(x, key):
            n = jax.random.normal(key, x.shape)
            return x + step * posterior.score(x) + noise * jnp.sqrt(step) * n, None

        def chain(key):
            key_start, key_moves = jax.random.split(key)
            x = posterior.start(key_start)
            return jax.lax.scan(move, x, jax.random.split(key_moves, steps))[0]

        return jax.vmap(chain)(jax.random.split(key, chains))[:, None]

    return sampler


# %% [markdown]
# The noise of Langevin dynamics is `sqrt(2 step)`. Who forgets the 2 samples a posterior that is
# too cold: its spread is too small by a factor of `sqrt(2)`. And whoever remembers it, but takes
# steps that are too long, samples one that is too warm.

# %%
attempts = {
    "without the 2": langevin(step=0.005, noise=1.0),
    "long steps": langevin(step=0.02, noise=np.sqrt(2)),
    "short steps": langevin(step=0.001, noise=np.sqrt(2), steps=5000),
}

# %% [markdown]
# ## The certificate
#
# The gallery holds problems whose posterior is known. `certify` simulates 200 objects and
# recordings of one, ranks every truth among the draws in thirteen quantities, and says one of three
# things: *passes*, *fails* (in what, and how), or *cannot be judged*, if there are too few
# independent draws to tell.

# %%
problem = {"linear Gaussian": GALLERY["linear Gaussian"]()}
certificates = {
    name: diagnostics.certify(sampler, problem, jax.random.key(0), 200, progress=False)
    for name, sampler in attempts.items()
}
for name, found in certificates.items():
    print(f"{name}: {found['linear Gaussian'].verdict}")

# %% [markdown]
# What does it look at? Ranks that are uniform have a distribution function on the diagonal; drawn
# is the difference from it. The grey band holds all lines together in 95 of 100 right samplers. A
# line far outside is a quantity in which truths are too often among the first, or the last.

# %%
figure, panels = plt.subplots(1, 3, figsize=(15, 3.6), layout="constrained")
for axes, (name, found) in zip(panels, certificates.items()):
    diagnostics.plot_ranks(found["linear Gaussian"].calibration, axes)
    axes.set_title(name)
figure.savefig("05_ranks.png", dpi=120)

# %% [markdown]
# ## What single pixels do not show
#
# Most people would look at one pixel: does the 80 % interval hold it 80 % of the time? The log-
# likelihood asks for all pixels at once, and for the recording. Compare what each of them says of
# the sampler with long steps.

# %%
ranks = certificates["long steps"]["linear Gaussian"].calibration
p = ranks.p
for name in ("mean [0:16]", "squared norm", "log-likelihood"):
    share, error = ranks.coverage(0.8)[name]
    print(
        f"{name}: 80 % intervals hold {100 * share:.0f} +- {100 * error:.0f} %, p = {p[name]:.1g}"
    )

# %% [markdown]
# An average of sixteen pixels covers as it should, though the sampler is wrong: its error hides in
# the stiff directions that the recording decides. A calibration test sees what you ask it about.
# Ask about the data.
#
# The same for every sampler of this package, and for all problems, from the command line:
# `posterior certify --sampler mala --out certificates`.

# %%
verdicts = {name: found["linear Gaussian"].verdict for name, found in certificates.items()}
assert verdicts["without the 2"].startswith("fails")
assert verdicts["long steps"].startswith("fails: log-likelihood")
assert verdicts["short steps"].startswith("passes")
assert p["mean [0:16]"] > 0.05 > p["log-likelihood"]
