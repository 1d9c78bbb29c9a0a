# %% [markdown]
# # What a calibration test cannot see
#
# A calibration test that passes says: *in what was asked*, truths and draws cannot be told apart.
# This notebook shows three samplers that are plainly wrong and pass a test that is widely used, and
# the question that finds each of them.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import posterior as ps
from posterior import diagnostics, models

# %% [markdown]
# ## A problem whose posterior is written down
#
# Sixty-four correlated unknowns behind a matrix of 48 rows, everything Gaussian: for a recording
# `y` the posterior has the mean `gain @ y` and one covariance for all recordings.

# %%
rng = np.random.default_rng(0)
size, rows, noise = 64, 48, 0.3
matrix = rng.standard_normal((rows, size)) / 8
root = rng.standard_normal((size, size)) / 8
prior_covariance = 0.5 * np.eye(size) + root @ root.T
problem = ps.Problem(
    models.LinearLikelihood(models.Matrix(matrix), models.Gaussian(noise)),
    models.GaussianPrior(np.zeros(size), prior_covariance, (size,)),
)
covariance = np.linalg.inv(np.linalg.inv(prior_covariance) + matrix.T @ matrix / noise**2)
gain = covariance @ matrix.T / noise**2


def drawn_with(covariance):
    cholesky = np.linalg.cholesky(covariance)

    def sampler(key, posterior):
        n = jax.random.normal(key, (1, 50, size))
        return gain @ posterior.y + n @ cholesky.T

    return sampler


# %% [markdown]
# Three samplers that are wrong. The first has never seen the recording. The second knows the spread
# of every unknown exactly, and nothing of how they vary together. The third is too narrow by 5 % in
# standard deviation, in every direction.


# %%
def of_the_prior(key, posterior):
    return jax.vmap(posterior.prior.sample)(jax.random.split(key, 50))[None]


samplers = {
    "exact": drawn_with(covariance),
    "the prior": of_the_prior,
    "no correlations": drawn_with(np.diag(np.diag(covariance))),
    "5 % too narrow": drawn_with(0.95**2 * covariance),
}

# %% [markdown]
# ## Four questions
#
# - **A pixel**: the rank of one unknown. What most papers plot.
# - **A fixed reference**: the rank of the distance to a point that was chosen beforehand, the
#   coverage test TARP with its usual random references.
# - **The norm**: one number of all unknowns.
# - **The likelihood**: how well does the object explain *this* recording?

# %%
questions = {
    "a pixel": lambda x, y: x[10],
    "a fixed reference": lambda x, y: jnp.sum((x - 1) ** 2),
    "the norm": lambda x, y: jnp.sum(x**2),
    "the likelihood": problem.likelihood.log_prob,
}
p = {
    name: diagnostics.sbc(
        problem, sampler, jax.random.key(1), 400, quantities=questions, progress=False
    ).p
    for name, sampler in samplers.items()
}
print(f"{'p-values':18}" + "".join(f"{question:>20}" for question in questions))
for name, found in p.items():
    print(f"{name:18}" + "".join(f"{found[question]:20.1g}" for question in questions))

# %% [markdown]
# The prior passes every question that does not involve the recording: truths *are* draws of the
# prior. Missing correlations are invisible in any single unknown. And a small error in each of 64
# directions is found only by a question that adds them up.

# %%
shown = np.array([[-np.log10(max(found[q], 1e-12)) for q in questions] for found in p.values()])
figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
image = axes.imshow(shown, cmap="magma", vmin=0, vmax=12, aspect="auto")
axes.set_xticks(range(len(questions)), questions)
axes.set_yticks(range(len(p)), p)
for (row, column), value in np.ndenumerate(shown):
    said = "caught" if value > 2 else "passes"
    axes.text(column, row, said, ha="center", va="center", color="0.2" if value > 6 else "w")
figure.colorbar(image, label="-log10 p")
figure.savefig("06_questions.png", dpi=120)

# %% [markdown]
# No question finds everything. `diagnostics.sbc` asks some thirteen at once and corrects the
# p-values for their number (Holm), so that an exact sampler still fails in no more than one run of
# twenty. What it cannot see, nobody has asked: add your own `f(x, y)` for what you will publish,
# the area of a cell, say.

# %%
assert min(p["exact"].values()) > 0.01
assert min(p["the prior"][q] for q in ("a pixel", "a fixed reference", "the norm")) > 0.01
assert p["the prior"]["the likelihood"] < 1e-6
assert p["no correlations"]["a pixel"] > 0.01 > p["no correlations"]["the likelihood"]
assert p["5 % too narrow"]["a pixel"] > 0.01
assert min(p["5 % too narrow"].values()) < 0.01
